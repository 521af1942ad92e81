#include <gtest/gtest.h>

#include <random>
#include <vector>

#include "soopnav/waveform/lte/pbch.hpp"
#include "soopnav/waveform/lte/sequences.hpp"
#include "soopnav/waveform/lte/synthesis.hpp"
#include "support/allocation_count.hpp"
#include "waveform/pbch_signal.hpp"

namespace soopnav::lte {
namespace {

using soopnav::test::allocations_of;
using soopnav::test::kAllocationsCounted;

TEST(SequencesNoAlloc, NothingAllocates) {
  if (!kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  static_cast<void>(pss(0));
  std::array<Cf32, 200> values;
  float sum = 0.0F;
  EXPECT_EQ(allocations_of([&] {
              crs_values(301, 4, 0, CyclicPrefix::kNormal, 100, values);
              sum = values[0].real() + sss(301, 5)[0] + pss(1)[0].real();
            }),
            0);
  EXPECT_NE(sum, 0.0F);
}

TEST(PbchNoAlloc, DecodingAndDemodulationDoNotAllocate) {
  if (!kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  std::mt19937_64 random(2);
  PbchDecoder decoder;
  for (const double noise_variance : {0.1, 30.0, 1e6}) {  // at once, by ordered statistics, not at all
    const test::PbchSender from{9, 2, CyclicPrefix::kNormal, {1.0, 1.0, 1.0, 1.0}, noise_variance, 1.0};
    auto soft = from.soft_bits({25, 8, false, 2, 0}, 40, random);
    const auto observation = from.frame({25, 8, false, 2, 0}, random);
    bool found = false;
    EXPECT_EQ(allocations_of([&] {
                demodulate_pbch(observation, 9, CyclicPrefix::kNormal, 2, soft[0]);
                found = decoder.decode(soft, 9, CyclicPrefix::kNormal, 2).has_value();
              }),
              0);
    EXPECT_EQ(found, noise_variance < 1e3);
  }
}

TEST(SynthesisNoAlloc, GenerateDoesNotAllocate) {
  if (!kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  CellParameters whole, stretched;
  whole.n_ports = 2;
  stretched.n_rb = 25;
  stretched.clock_error_ppm = 5.0;
  stretched.taps = {{0.0, 1.0}, {1e-6, 0.5}};
  const std::vector<CellParameters> cells{whole, stretched};
  Synthesizer synthesizer(cells, 7.68e6, 0.1, 3);
  std::vector<Cf32> block(10000);
  EXPECT_EQ(allocations_of([&] { synthesizer.generate(block); }), 0);
  EXPECT_NE(block[0], Cf32{});
}

}  // namespace
}  // namespace soopnav::lte

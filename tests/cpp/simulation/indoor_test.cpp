// Rooms, sounders and what is made of their records: values, laws, refusals, no heap.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <stdexcept>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/simulation/channel_sounder.hpp"
#include "soopnav/simulation/indoor_room.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::simulation {
namespace {

using Complex = std::complex<double>;
using Eigen::Vector3d;
constexpr double kInf = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

IndoorRoomOptions plain(int order) {
  IndoorRoomOptions o;
  o.order = order;
  o.tail_db = -kInf;
  o.floor_and_ceiling = false;
  o.path_range_db = 200.0;
  return o;
}

IndoorLink link_of(const IndoorRoom& room, const Vector3d& node, const Vector3d& place) {
  IndoorLink link = room.make_link();
  room.link(room.node(node), place, link);
  return link;
}

TEST(Slab, FaceAndSheetByHand) {
  // A sheet of a quarter wave of glass: r = (1 - n) / (1 + n), R = 2 r / (1 + r^2) without loss.
  const double n = std::sqrt(6.31), r = (1.0 - n) / (1.0 + n);
  const double f = 1e9, quarter = kSpeedOfLightMps / f / n / 4.0;
  const auto sheet = slab_response(Material::kGlass, quarter, 1.0, f);
  EXPECT_NEAR(std::abs(sheet.reflection), std::abs(2.0 * r / (1.0 + r * r)), 6e-3);
  EXPECT_NEAR(std::norm(sheet.reflection) + std::norm(sheet.transmission), 1.0, 0.02);
  EXPECT_LT(std::norm(sheet.reflection) + std::norm(sheet.transmission), 1.0);
  EXPECT_NEAR(sheet.delay_s, quarter * (n - 1.0) / kSpeedOfLightMps, 1e-14);
  // Concrete from tables: 0.2 m at 2 GHz takes some 13 dB; metal all, and turns the sign.
  EXPECT_NEAR(-20.0 * std::log10(std::abs(slab_response(Material::kConcrete, 0.2, 1.0, 2e9).transmission)), 12.7, 0.3);
  const auto metal = slab_response(Material::kMetal, 0.01, 0.5, 2e9);
  EXPECT_LT(std::abs(metal.transmission), 1e-9);
  EXPECT_NEAR(metal.reflection.real(), -1.0, 1e-3);
  // No perpendicular reflection differs from the parallel one straight on, but for the sign of E's reference.
  EXPECT_NEAR(std::abs(slab_response(Material::kBrick, 0.2, 1.0, 2e9).reflection),
              std::abs(slab_response(Material::kBrick, 0.2, 1.0, 2e9, true).reflection), 1e-12);
  EXPECT_THROW(static_cast<void>(slab_response(Material::kBrick, 0.0, 1.0, 2e9)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(slab_response(Material::kBrick, 0.1, 0.0, 2e9)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(slab_response(Material::kBrick, 0.1, 1.0, kNan)), std::invalid_argument);
}

// A rectangle has 2 k (k + 1) + 1 paths up to order k, each as long as the way to a mirror image of the lattice.
TEST(IndoorRoom, PathsOfARectangleAreTheLatticeOfImages) {
  const double w = 20.0, d = 15.0;
  const Vector3d node(3.0, 4.0, 1.0), place(15.0, 12.0, 2.0);
  for (int order = 0; order <= 3; ++order) {
    const IndoorRoom room(rectangle_walls(w, d, Material::kMetal, 0.01), plain(order));
    const IndoorLink link = link_of(room, node, place);
    std::vector<double> expected;
    for (int i = -order; i <= order; ++i) {
      for (int j = -order; j <= order; ++j) {
        if (std::abs(i) + std::abs(j) > order) continue;
        const double x = i % 2 == 0 ? i * w + node.x() : (i + 1) * w - node.x();
        const double y = j % 2 == 0 ? j * d + node.y() : (j + 1) * d - node.y();
        expected.push_back(Vector3d(x - place.x(), y - place.y(), 1.0).norm() / kSpeedOfLightMps);
      }
    }
    std::ranges::sort(expected);
    ASSERT_EQ(link.taps.size(), expected.size()) << order;
    const double lambda = kSpeedOfLightMps / 2e9;
    for (std::size_t i = 0; i < expected.size(); ++i) {
      EXPECT_NEAR(link.taps[i].delay_s, expected[i], 1e-15);
      EXPECT_NEAR(std::abs(link.taps[i].gain), lambda / (4.0 * kPi * expected[i] * kSpeedOfLightMps), 2e-6);
    }
  }
}

TEST(IndoorRoom, IsReciprocalAndPassesThroughWalls) {
  auto walls = rectangle_walls(20.0, 20.0, Material::kBrick, 0.25);
  const auto south = with_opening(walls[0], 2.0, 8.0);
  walls.erase(walls.begin());
  walls.insert(walls.end(), south.begin(), south.end());
  walls.push_back({{10.0, 5.0}, {12.0, 12.0}, Material::kPlaster, 0.1});
  IndoorRoomOptions o = plain(2);
  o.floor_and_ceiling = true;
  const IndoorRoom room(walls, o);
  RandomStream random(4);
  for (int i = 0; i < 50; ++i) {
    const Vector3d a(random.uniform(0, 20), random.uniform(0, 20), random.uniform(0.1, 2.9));
    const Vector3d b(random.uniform(-30, 50), random.uniform(-30, 50), random.uniform(0.1, 2.9));
    const auto there = link_of(room, a, b), back = link_of(room, b, a);
    ASSERT_EQ(there.taps.size(), back.taps.size());
    Complex sum;
    for (const Tap& tap : there.taps) sum += tap.gain;
    for (const Tap& tap : back.taps) sum -= tap.gain;
    EXPECT_LT(std::abs(sum), 1e-9 * std::sqrt(std::pow(10.0, 0.1 * there.power_db)));
    EXPECT_NEAR(there.wall_loss_db, back.wall_loss_db, 1e-9);
  }
  // Through the window in sight, through brick not, over the wall again; the direct path as the slab says.
  EXPECT_TRUE(link_of(room, {5.0, -30.0, 1.0}, {5.0, 5.0, 1.0}).line_of_sight);
  const auto shut = link_of(room, {15.0, -30.0, 1.0}, {15.0, 5.0, 1.0});
  EXPECT_FALSE(shut.line_of_sight);
  const auto slab = slab_response(Material::kBrick, 0.25, 1.0, 2e9);
  EXPECT_NEAR(shut.wall_loss_db, -20.0 * std::log10(std::abs(slab.transmission)), 1e-9);
  EXPECT_NEAR(shut.taps.front().delay_s, 35.0 / kSpeedOfLightMps + slab.delay_s, 1e-15);
  EXPECT_TRUE(link_of(room, {15.0, -30.0, 20.0}, {15.0, 5.0, 2.0}).line_of_sight);
}

TEST(IndoorRoom, BehindMetalTheFirstPathIsLate) {
  auto walls = rectangle_walls(20.0, 10.0, Material::kConcrete);
  walls.push_back({{10.0, 0.0}, {10.0, 6.0}, Material::kMetal, 0.01});
  const IndoorRoom room(walls, plain(1));
  const auto link = link_of(room, {5.0, 4.0, 1.0}, {14.0, 4.0, 1.0});
  EXPECT_FALSE(link.line_of_sight);
  // Over the north wall y = 10: 12 m up and down for 9 m along.
  EXPECT_NEAR(link.excess_delay_s * kSpeedOfLightMps, std::hypot(9.0, 12.0) - 9.0, 1e-9);
}

TEST(IndoorRoom, TailHasItsPowerAndIsTheSameAgain) {
  IndoorRoomOptions o = plain(0);
  o.tail_db = -6.0;
  o.tail_taps = 32;
  o.path_range_db = 40.0;
  const IndoorRoom room(rectangle_walls(30.0, 30.0), o);
  const RoomNode node = room.node({2.0, 3.0, 1.0});
  IndoorLink link = room.make_link();
  double tail = 0.0;
  RandomStream random(9);
  const int n = 400;
  for (int i = 0; i < n; ++i) {
    room.link(node, {random.uniform(8, 28), random.uniform(8, 28), 1.0}, link);
    ASSERT_EQ(link.status, LinkStatus::kOk);
    const double direct = std::norm(link.taps.front().gain);
    tail += (std::pow(10.0, 0.1 * link.power_db) - direct) / direct / n;
  }
  // Some 8 taps carry it: the mean over 400 places is good to 0.25 / (20 sqrt(8)) = 2 %; five times that.
  EXPECT_NEAR(tail, std::pow(10.0, -0.6), 0.025);
  room.link(node, {10.0, 10.0, 1.0}, link);
  const auto first = link.taps;
  room.link(node, {11.0, 10.0, 1.0}, link);
  room.link(node, {10.0, 10.0, 1.0}, link);
  for (std::size_t i = 0; i < first.size(); ++i) EXPECT_EQ(first[i].gain, link.taps[i].gain);
}

TEST(IndoorRoom, BadPlacesAndSetUpsAreNamed) {
  const IndoorRoom room(rectangle_walls(10.0, 10.0, Material::kMetal, 0.01), plain(1));
  EXPECT_EQ(link_of(room, {1.0, 1.0, 1.0}, {kNan, 1.0, 1.0}).status, LinkStatus::kNotFinite);
  EXPECT_EQ(link_of(room, {1.0, 1.0, 1.0}, {1.0, 1.05, 1.0}).status, LinkStatus::kTooClose);
  const auto dark = link_of(room, {-5.0, 1.0, 1.0}, {4.0, 4.0, 1.0});
  EXPECT_EQ(dark.status, LinkStatus::kDark);
  EXPECT_TRUE(dark.taps.empty());
  IndoorRoomOptions o;
  o.order = 4;
  EXPECT_THROW(IndoorRoom(rectangle_walls(10.0, 10.0), o), std::invalid_argument);
  EXPECT_THROW(IndoorRoom({}, IndoorRoomOptions{}), std::invalid_argument);
  EXPECT_THROW(IndoorRoom({Wall{}}, IndoorRoomOptions{}), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(room.node({kInf, 0.0, 0.0})), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(with_opening(rectangle_walls(4.0, 4.0)[0], 3.0, 5.0)), std::invalid_argument);
}

TEST(ExcessDelays, BiasAtTheBoundaryThenAWalk) {
  const std::size_t n = 20000, links = 2;
  std::vector<std::uint8_t> sight(n * links, 0);
  for (std::size_t k = 0; k < n; ++k) sight[k * links] = k % 2 == 0;  // link 0 shuts at every other epoch
  std::vector<double> excess(n * links);
  const ExcessDelayOptions o{4.0, 20.0, 0.158, 0.0};
  excess_delays(sight, links, 0.1, o, RandomStream(2), excess);
  double mean = 0.0, steps = 0.0;
  for (std::size_t k = 1; k < n; ++k) {
    const double now = excess[k * links];
    EXPECT_TRUE(k % 2 == 0 ? now == 0.0 : now >= 4.0 && now <= 20.0);
    mean += now / (0.5 * n);
    const double step = std::abs(excess[k * links + 1] - excess[(k - 1) * links + 1]);
    steps += step * step / n;
  }
  EXPECT_NEAR(mean, 12.0, 5.0 * 4.62 / 100.0);      // uniform of 16 m over 10 000 entries
  EXPECT_NEAR(std::sqrt(steps) / 0.05, 1.0, 0.05);  // 0.158 sqrt(0.1)
  EXPECT_THROW(excess_delays(sight, 3, 0.1, o, RandomStream(2), excess), std::invalid_argument);
  EXPECT_THROW(excess_delays(sight, 2, 0.1, {4.0, 3.0, 0.1, 0.0}, RandomStream(2), excess), std::invalid_argument);
}

SounderOptions quick() {
  SounderOptions o;
  o.averages = 50;
  o.calibration_averages = 400;
  o.seed = 5;
  return o;
}

TEST(ChannelSounder, LinesOfThePulse) {
  SounderOptions o = quick();
  o.filter_hz = 1e12;
  const ChannelSounder sounder(o);
  const auto f = sounder.line_hz();
  ASSERT_EQ(f.size(), 399U);
  const auto level = [&](double hz) {
    const auto at = std::ranges::find_if(f, [hz](double x) { return std::abs(x - hz) < 1.0; });
    return 20.0 * std::log10(std::abs(sounder.lines()[static_cast<std::size_t>(at - f.begin())]) / 0.01);
  };
  EXPECT_NEAR(level(0.0), 0.0, 1e-9);
  EXPECT_NEAR(level(2.5e6), -0.91, 0.01);
  EXPECT_NEAR(level(4.5e6), -3.12, 0.02);
  EXPECT_NEAR(level(9e6), -19.2, 0.1);
  EXPECT_NEAR(level(-9.9e6), -39.9, 0.1);
  EXPECT_LT(level(10e6), -250.0);
}

TEST(ChannelSounder, RecordsHaveTheStatedNoise) {
  ChannelSounder sounder(quick());
  const std::vector<std::vector<Tap>> ports{{{50e-9, {0.6, 0.3}}, {180e-9, {-0.2, 0.4}}}};
  std::vector<Complex> cable(sounder.line_hz().size()), lines(cable.size());
  EXPECT_EQ(sounder.calibrate(cable).clipped, 0U);
  double power = 0.0, count = 0.0;
  for (std::uint64_t slot = 0; slot < 10; ++slot) {
    const auto report = sounder.record(ports, 0, slot, lines);
    EXPECT_EQ(report.clipped, 0U);
    EXPECT_NEAR(report.time_s, static_cast<double>(slot) * 1.5e-3 + 1e-3, 1e-12);
    const Complex session = cable[199] / sounder.lines()[199];
    for (std::size_t m = 0; m < lines.size(); ++m) {
      Complex h;
      for (const Tap& tap : ports[0]) h += tap.gain * std::polar(1.0, -2.0 * kPi * sounder.line_hz()[m] * tap.delay_s);
      if (std::abs(sounder.lines()[m]) > 0.002) continue;  // where phase noise is less than the noise of a line
      power += std::norm(lines[m] - h * session * sounder.lines()[m]) / sounder.line_noise_variance(50);
      count += 1.0;
    }
  }
  EXPECT_NEAR(power / count, 1.0, 5.0 / std::sqrt(count));
}

TEST(ChannelSounder, GuardIsolationAndClock) {
  const std::vector<std::vector<Tap>> ports{{{0.0, 0.0}}, {{0.0, 1.0}}};
  const auto leak_db = [&](SounderOptions o) {
    ChannelSounder sounder(o);
    std::vector<Complex> lines(sounder.line_hz().size());
    static_cast<void>(sounder.record(ports, 0, 0, lines));
    return 20.0 * std::log10(std::abs(lines[199]) / 0.01);
  };
  SounderOptions o = quick();
  o.snr_db = 80.0;
  o.adc_bits = 0;
  o.isolation_db = 50.0;
  EXPECT_NEAR(leak_db(o), -50.0, 0.5);
  o.guard_s = 0.0;  // the port before fades while 0.5 ms are averaged: 50 us / 500 us of it
  EXPECT_NEAR(leak_db(o), -19.1, 0.5);
  o = quick();
  o.shared_reference = false;
  o.clock_rad_per_sqrt_s = 300.0;  // far beyond 1 rad in the average
  ChannelSounder sounder(o);
  std::vector<Complex> lines(sounder.line_hz().size());
  static_cast<void>(sounder.record(ports, 1, 0, lines));
  EXPECT_LT(std::abs(lines[199]), 0.009);
}

TEST(ChannelEmulator, MakesNarrowAndWideChannels) {
  SounderOptions o = quick();
  o.averages = 400;
  o.calibration_averages = 6400;
  ChannelSounder sounder(o);
  const std::vector<std::vector<Tap>> ports{{{43e-9, {0.6, 0.3}}, {131e-9, {-0.3, 0.5}}, {410e-9, {0.2, 0.2}}}};
  std::vector<Complex> cable(sounder.line_hz().size()), lines(cable.size());
  static_cast<void>(sounder.calibrate(cable));
  static_cast<void>(sounder.record(ports, 0, 0, lines));
  for (const double bandwidth : {1.08e6, 4.5e6, 18e6}) {
    EmulatorOptions e;
    e.bandwidth_hz = bandwidth;
    e.noise_to_signal = sounder.line_noise_variance(400) / 1e-4;
    const ChannelEmulator emulator(sounder.line_hz(), cable, e);
    EXPECT_TRUE(emulator.covered());
    EXPECT_TRUE(std::ranges::any_of(emulator.nulls_hz(), [](double f) { return std::abs(f - 10e6) < 1.0; }));
    EXPECT_TRUE(std::ranges::any_of(emulator.nulls_hz(), [](double f) { return std::abs(f + 10e6) < 1.0; }));
    std::vector<Complex> gain(emulator.delays_s().size());
    ASSERT_TRUE(emulator.taps(lines, gain));
    double error = 0.0, power = 0.0;
    for (double f = -0.5 * bandwidth; f <= 0.5 * bandwidth; f += bandwidth / 50.0) {
      Complex h, made;
      for (const Tap& tap : ports[0]) h += tap.gain * std::polar(1.0, -2.0 * kPi * f * tap.delay_s);
      for (std::size_t d = 0; d < gain.size(); ++d) {
        made += gain[d] * std::polar(1.0, -2.0 * kPi * f * emulator.delays_s()[d]);
      }
      error += std::norm(made - h);
      power += std::norm(h);
    }
    EXPECT_LT(std::sqrt(error / power), 2e-3) << bandwidth;
    lines[199] = kNan;
    EXPECT_FALSE(emulator.taps(lines, gain));
    static_cast<void>(sounder.record(ports, 0, 0, lines));
  }
  EmulatorOptions wide;
  wide.bandwidth_hz = 20e6;
  const ChannelEmulator beyond(sounder.line_hz(), cable, wide);
  EXPECT_FALSE(beyond.covered());
  EXPECT_GT(beyond.sigma(10e6), 10.0 * beyond.sigma(0.0));
  wide.delay_high_s = 1e-3;
  EXPECT_THROW(ChannelEmulator(sounder.line_hz(), cable, wide), std::invalid_argument);
  EXPECT_THROW(ChannelEmulator(sounder.line_hz().first(5), cable, EmulatorOptions{}), std::invalid_argument);
}

TEST(StepSweep, LosesPhaseFromToneToTone) {
  const std::size_t places = 3, tones = 40;
  std::vector<Complex> truth(places * tones), measured(truth.size());
  for (std::size_t i = 0; i < truth.size(); ++i) truth[i] = std::polar(1.0, 0.37 * static_cast<double>(i));
  step_sweep(truth, tones, {}, 3, measured);
  Complex across, along;
  for (std::size_t f = 0; f < tones; ++f) {
    across += measured[f] / truth[f] * std::conj(measured[tones + f] / truth[tones + f]);
    along += measured[f] / truth[f];
  }
  EXPECT_NEAR(std::abs(across) / tones, 1.0, 0.01);  // one phase for all places
  EXPECT_LT(std::abs(along) / tones, 0.6);           // another at each tone; 0.6 sqrt(40): 5e-7
  SweepOptions reference;
  reference.reference_channel = true;
  step_sweep(truth, tones, reference, 3, measured);
  for (std::size_t i = 0; i < truth.size(); ++i) EXPECT_LT(std::abs(measured[i] - truth[i]), 0.012);
  EXPECT_THROW(step_sweep(truth, 7, {}, 3, measured), std::invalid_argument);
}

TEST(ChannelSounder, SetUpsAreRefused) {
  const auto refused = [](auto change) {
    SounderOptions o;
    change(o);
    EXPECT_THROW(ChannelSounder{o}, std::invalid_argument);
  };
  refused([](SounderOptions& o) { o.period_s = 10.005e-6; });
  refused([](SounderOptions& o) { o.pulse_s = 0.0; });
  refused([](SounderOptions& o) { o.if_hz = 30e6; });
  refused([](SounderOptions& o) { o.averages = 0; });
  refused([](SounderOptions& o) { o.adc_bits = 1; });
  refused([](SounderOptions& o) { o.snr_db = kNan; });
}

TEST(Indoor, AllocatesNothingPerCall) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  const IndoorRoom room(rectangle_walls(20.0, 15.0), IndoorRoomOptions{});
  const RoomNode node = room.node({50.0, 3.0, 2.0});
  IndoorLink link = room.make_link();
  EXPECT_EQ(test::allocations_of([&] {
              for (int i = 0; i < 20; ++i) room.link(node, {1.0 + 0.5 * i, 7.0, 1.2}, link);
            }),
            0);
  SounderOptions o = quick();
  o.averages = 2;
  ChannelSounder sounder(o);
  const std::vector<std::vector<Tap>> ports{{{50e-9, 1.0}}};
  std::vector<Complex> lines(sounder.line_hz().size());
  EmulatorOptions narrow;
  narrow.bandwidth_hz = 1.08e6;
  const ChannelEmulator emulator(sounder.line_hz(), sounder.lines(), narrow);
  std::vector<Complex> gain(emulator.delays_s().size());
  EXPECT_EQ(test::allocations_of([&] {
              static_cast<void>(sounder.record(ports, 0, 0, lines));
              static_cast<void>(emulator.taps(lines, gain));
            }),
            0);
}

}  // namespace
}  // namespace soopnav::simulation

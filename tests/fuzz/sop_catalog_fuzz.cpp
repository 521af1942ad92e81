// A snapshot of arbitrary bytes: refused with a sentence, or read into sources that are written as the same bytes and
// whose priors are finite. Bytes that would only fail at the checksum are given the right one half of the time.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>
#include <stdexcept>
#include <vector>

#include "soopnav/navigation/sop_catalog.hpp"

namespace navigation = soopnav::navigation;

namespace {

void demand(bool condition) {
  if (!condition) std::abort();
}

void check(std::span<const std::byte> bytes) {
  try {
    const auto catalog = navigation::SopCatalog::read(bytes);
    for (const navigation::SopSource& source : catalog.sources()) {
      demand(catalog.find(source.id) == &source);
      navigation::SopPrior prior;
      if (!navigation::prior(source, soopnav::Epoch(soopnav::TimeScale::kUtc, 1'800'000'000, 0.0), prior)) continue;
      demand(prior.clock.allFinite() && prior.clock_covariance.allFinite() && prior.p_e_m.allFinite());
      demand(std::isfinite(prior.noise.white_frequency_m2ps));
    }
    const auto again = navigation::write_snapshot(catalog.sources(), catalog.created_us());
    demand(again.size() == bytes.size());
    demand(navigation::SopCatalog::read(again).sources().size() == catalog.sources().size());
  } catch (const std::invalid_argument& error) {
    demand(error.what()[0] != '\0');
  }
}

/// CRC-32 bit by bit.
std::uint32_t checksum(std::span<const std::byte> bytes, std::size_t leave_out) {
  std::uint32_t crc = ~0U;
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    if (i >= leave_out && i < leave_out + 4) continue;
    crc ^= std::to_integer<std::uint32_t>(bytes[i]);
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 1U) != 0 ? 0xEDB88320U ^ (crc >> 1U) : crc >> 1U;
  }
  return ~crc;
}

void seal(std::vector<std::byte>& bytes) {
  const std::uint32_t crc = checksum(bytes, 36);
  for (std::size_t i = 0; i < 4; ++i) bytes[36 + i] = static_cast<std::byte>((crc >> (8 * i)) & 0xFFU);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  check(std::as_bytes(std::span(data, size)));
  // A right snapshot with the input's bytes laid over it, from where its first two say.
  navigation::SopSource source;
  source.id = "a";
  source.carrier_hz = 8.8e8;
  source.position = navigation::SopPosition{};
  source.position->value = {6.4e6, 1.0, 2.0};
  source.clock = navigation::SopClock{};
  source.noise = navigation::SopNoise{{-53.0, -57.0}, Eigen::Matrix2d::Identity()};
  std::vector<navigation::SopSource> sources{source, source};
  sources[1].id = "b";
  auto bytes = navigation::write_snapshot(sources, 1);
  demand(navigation::SopCatalog::read(bytes).sources().size() == 2);
  if (size < 3) return 0;
  const std::size_t from = (data[0] * 256U + data[1]) % bytes.size();
  for (std::size_t i = 2; i < size && from + i - 2 < bytes.size(); ++i)
    bytes[from + i - 2] = static_cast<std::byte>(data[i]);
  check(bytes);
  seal(bytes);
  check(bytes);
  return 0;
}

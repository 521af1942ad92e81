#include "soopnav/navigation/sop_catalog.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <stdexcept>

#include "soopnav/core/constants.hpp"

namespace soopnav::navigation {
namespace {

constexpr std::array<std::uint8_t, 8> kMagic{'S', 'O', 'P', 'C', 'A', 'T', '\r', '\n'};
constexpr std::uint16_t kVersion = 1;
constexpr std::size_t kHeaderBytes = 40;
constexpr std::size_t kCrcAt = 36;
constexpr std::size_t kIdBytes = 40;
constexpr std::size_t kNameBytes = 400;
constexpr std::size_t kRecordBytes = 624;
constexpr std::uint8_t kHasPosition = 1, kHasClock = 2, kHasNoise = 4;
constexpr double kYearS = 365.25 * 86400.0;
constexpr double kPositionWalkM2ps = 1.0 / kYearS;  // as the service ages answers
constexpr double kLnWalkPerS = 1.0 / kYearS;
constexpr double kMostLnVariance = 25.0;
constexpr double kMostLn = 200.0;                           // exp of it and of twice it are finite
constexpr std::int64_t kFirstUs = -62'135'596'800'000'000;  // year 1
constexpr std::int64_t kLastUs = 253'402'300'799'999'999;   // the end of year 9999
constexpr std::array<std::string_view, 7> kKinds{"other", "cdma", "gps", "iridium", "lte", "ofdm", "fm"};

constexpr std::array<std::uint32_t, 256> crc_table() {
  std::array<std::uint32_t, 256> table{};
  for (std::uint32_t i = 0; i < 256; ++i) {
    std::uint32_t word = i;
    for (int bit = 0; bit < 8; ++bit) word = (word & 1U) != 0 ? 0xEDB88320U ^ (word >> 1U) : word >> 1U;
    table[i] = word;
  }
  return table;
}

/// CRC-32 of IEEE 802.3 (ISO 3309), as zlib has it.
std::uint32_t crc32(std::uint32_t crc, std::span<const std::byte> bytes) noexcept {
  static constexpr auto kTable = crc_table();
  crc = ~crc;
  for (const std::byte b : bytes) crc = kTable[(crc ^ std::to_integer<std::uint32_t>(b)) & 0xFFU] ^ (crc >> 8U);
  return ~crc;
}

/// Little-endian numbers, whatever this machine's order.
class Writer {
 public:
  explicit Writer(std::vector<std::byte>& out) : out_(out) {}
  template <class T>
  void whole(T value) {
    for (std::size_t i = 0; i < sizeof(T); ++i) {
      out_.push_back(static_cast<std::byte>((static_cast<std::uint64_t>(value) >> (8 * i)) & 0xFFU));
    }
  }
  void real(double value) { whole(std::bit_cast<std::uint64_t>(value)); }
  void text(std::string_view value, std::size_t size) {
    for (std::size_t i = 0; i < size; ++i)
      out_.push_back(i < value.size() ? static_cast<std::byte>(value[i]) : std::byte{0});
  }
  template <int N>
  void values(const SopEstimate<N>& e) {
    for (int i = 0; i < N; ++i) real(e.value[i]);
    for (int i = 0; i < N; ++i) {
      for (int j = i; j < N; ++j) real(e.covariance(i, j));
    }
  }

 private:
  std::vector<std::byte>& out_;
};

class Reader {
 public:
  explicit Reader(std::span<const std::byte> bytes) : bytes_(bytes) {}
  template <class T>
  T whole() {
    std::uint64_t value = 0;
    for (std::size_t i = 0; i < sizeof(T); ++i) value |= std::to_integer<std::uint64_t>(bytes_[at_ + i]) << (8 * i);
    at_ += sizeof(T);
    return static_cast<T>(value);
  }
  double real() { return std::bit_cast<double>(whole<std::uint64_t>()); }
  std::string text(std::size_t size) {
    std::string out(size, '\0');
    for (std::size_t i = 0; i < size; ++i) out[i] = static_cast<char>(bytes_[at_ + i]);
    at_ += size;
    out.resize(std::min(out.find('\0'), size));
    return out;
  }
  template <int N>
  SopEstimate<N> values() {
    SopEstimate<N> e;
    for (int i = 0; i < N; ++i) e.value[i] = real();
    for (int i = 0; i < N; ++i) {
      for (int j = i; j < N; ++j) e.covariance(i, j) = e.covariance(j, i) = real();
    }
    return e;
  }

 private:
  std::span<const std::byte> bytes_;
  std::size_t at_ = 0;
};

[[noreturn]] void refuse(const std::string& sentence) { throw std::invalid_argument("snapshot: " + sentence); }

template <int N>
void check_estimate(const SopEstimate<N>& e, const std::string& where, const char* part) {
  if (!e.value.allFinite() || !e.covariance.allFinite()) refuse(where + part + " must have finite numbers");
  if (!(e.covariance.diagonal().minCoeff() > 0.0)) refuse(where + part + " must have positive variances");
  for (int i = 0; i < N; ++i) {
    for (int j = 0; j < i; ++j) {
      if (std::abs(e.covariance(i, j)) > (1.0 + 1e-9) * std::sqrt(e.covariance(i, i)) * std::sqrt(e.covariance(j, j))) {
        refuse(where + part + " must have correlations within -1 and 1");
      }
    }
  }
}

SopEstimate<2> as_estimate(const SopNoise& noise) {
  SopEstimate<2> e;
  e.value = noise.ln_h;
  e.covariance = noise.ln_covariance;
  return e;
}

/// Whether text is UTF-8 (shortest forms, no surrogates) without control characters, so that it can be printed.
bool is_printable_utf8(std::string_view text) noexcept {
  for (std::size_t i = 0; i < text.size();) {
    const auto byte = [&](std::size_t k) noexcept {
      return static_cast<std::uint32_t>(static_cast<unsigned char>(text[k]));
    };
    const std::uint32_t first = byte(i);
    const std::size_t size = first < 0x80 ? 1 : first >> 5 == 6 ? 2 : first >> 4 == 14 ? 3 : first >> 3 == 30 ? 4 : 0;
    if (size == 0 || size > text.size() - i) return false;
    std::uint32_t code = size == 1 ? first : first & (0x7FU >> size);
    for (std::size_t k = 1; k < size; ++k) {
      if (byte(i + k) >> 6 != 2) return false;
      code = code << 6 | (byte(i + k) & 0x3FU);
    }
    constexpr std::array<std::uint32_t, 5> kLeast{0, 0, 0x80, 0x800, 0x10000};
    if (code < kLeast[size] || code > 0x10FFFF || (code >= 0xD800 && code < 0xE000)) return false;
    if (code < 0x20 || (code >= 0x7F && code < 0xA0)) return false;
    i += size;
  }
  return true;
}

void check_time(std::int64_t us, const std::string& where, const char* part) {
  if (us < kFirstUs || us > kLastUs) refuse(where + part + " between the years 1 and 9999 expected");
}

void check_source(const SopSource& source, const std::string& where) {
  if (source.id.empty() || source.id.size() > kIdBytes) refuse(where + "an id of 1 to 40 bytes expected");
  if (source.name.size() > kNameBytes) refuse(where + "a name of at most 400 bytes expected");
  if (!is_printable_utf8(source.id) || !is_printable_utf8(source.name)) {
    refuse(where + "an id and a name of UTF-8 without control characters expected");
  }
  if (static_cast<std::size_t>(source.kind) >= kKinds.size()) refuse(where + "a known kind expected");
  if (!(source.carrier_hz > 0.0) || !std::isfinite(source.carrier_hz)) refuse(where + "a positive carrier expected");
  if (source.grade < 'A' || source.grade > 'D') refuse(where + "a grade from A to D expected");
  check_time(source.newest_us, where, "a newest contribution");
  check_time(source.at_us, where, "a state");
  if (source.position) check_estimate(*source.position, where, "its position");
  if (source.clock) check_estimate(*source.clock, where, "its clock");
  if (source.noise) {
    check_estimate(as_estimate(*source.noise), where, "its noise");
    if (!(source.noise->ln_h.cwiseAbs().maxCoeff() < kMostLn)) refuse(where + "logarithms of noise below 200 expected");
  }
}

Epoch epoch_of(std::int64_t us) noexcept {
  const std::int64_t seconds = us / 1'000'000;
  return {TimeScale::kUtc, seconds, static_cast<double>(us - seconds * 1'000'000) * 1e-6};
}

}  // namespace

std::string_view to_string(SopKind kind) noexcept {
  const auto i = static_cast<std::size_t>(kind);
  return i < kKinds.size() ? kKinds[i] : std::string_view("unknown");
}

SopCatalog SopCatalog::read(std::span<const std::byte> bytes) {
  if (bytes.size() < kHeaderBytes) {
    refuse("a header of " + std::to_string(kHeaderBytes) + " bytes expected, got " + std::to_string(bytes.size()));
  }
  Reader header(bytes);
  for (const std::uint8_t expected : kMagic) {
    if (header.whole<std::uint8_t>() != expected) refuse("the first bytes are not those of a snapshot");
  }
  const auto version = header.whole<std::uint16_t>();
  if (version != kVersion) refuse("version " + std::to_string(version) + "; this program reads version 1");
  const auto header_bytes = header.whole<std::uint16_t>();
  const auto record_bytes = header.whole<std::uint32_t>();
  if (header_bytes != kHeaderBytes || record_bytes != kRecordBytes) {
    refuse("a header of 40 bytes and records of 624 expected, got " + std::to_string(header_bytes) + " and " +
           std::to_string(record_bytes));
  }
  const auto count = header.whole<std::uint64_t>();
  const std::span<const std::byte> body = bytes.subspan(kHeaderBytes);
  if (body.size() % kRecordBytes != 0 || count != body.size() / kRecordBytes) {
    refuse(std::to_string(count) + " records of 624 bytes expected, got " + std::to_string(body.size()) + " bytes");
  }
  SopCatalog out;
  out.created_us_ = header.whole<std::int64_t>();
  static_cast<void>(header.whole<std::uint32_t>());  // reserved
  const auto crc = header.whole<std::uint32_t>();
  if (crc32(crc32(0, bytes.first(kCrcAt)), body) != crc) refuse("the checksum does not fit: the file is damaged");
  check_time(out.created_us_, "", "a time of its making");

  out.sources_.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    Reader record(body.subspan(i * kRecordBytes, kRecordBytes));
    SopSource source;
    source.id = record.text(kIdBytes);
    source.name = record.text(kNameBytes);
    source.kind = static_cast<SopKind>(record.whole<std::uint8_t>());
    const auto has = record.whole<std::uint8_t>();
    source.grade = static_cast<char>(record.whole<std::uint8_t>());
    static_cast<void>(record.whole<std::uint8_t>());  // reserved
    source.contributions = record.whole<std::uint32_t>();
    source.carrier_hz = record.real();
    source.newest_us = record.whole<std::int64_t>();
    source.at_us = record.whole<std::int64_t>();
    const auto position = record.values<3>();
    const auto clock = record.values<2>();
    const auto noise = record.values<2>();
    if ((has & kHasPosition) != 0) source.position = position;
    if ((has & kHasClock) != 0) source.clock = clock;
    if ((has & kHasNoise) != 0) source.noise = SopNoise{noise.value, noise.covariance};
    const std::string where = "record " + std::to_string(i) + ": ";
    check_source(source, where);
    if (i > 0 && !(out.sources_.back().id < source.id)) refuse(where + "ids that rise expected");
    out.sources_.push_back(std::move(source));
  }
  return out;
}

SopCatalog SopCatalog::open(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::invalid_argument(path.string() + ": cannot be read");
  const std::vector<char> content{std::istreambuf_iterator<char>(file), {}};
  if (file.bad()) throw std::invalid_argument(path.string() + ": cannot be read");
  try {
    return read(std::as_bytes(std::span(content)));
  } catch (const std::invalid_argument& error) {
    throw std::invalid_argument(path.string() + ": " + error.what());
  }
}

const SopSource* SopCatalog::find(std::string_view id) const noexcept {
  const auto it = std::lower_bound(sources_.begin(), sources_.end(), id,
                                   [](const SopSource& source, std::string_view key) { return source.id < key; });
  return it != sources_.end() && it->id == id ? &*it : nullptr;
}

std::size_t SopCatalog::find(SopKind kind, double carrier_hz, double tolerance_hz,
                             std::span<const SopSource*> out) const noexcept {
  std::size_t count = 0;
  for (const SopSource& source : sources_) {
    if (source.kind != kind || !(std::abs(source.carrier_hz - carrier_hz) <= tolerance_hz)) continue;
    if (count < out.size()) out[count] = &source;
    ++count;
  }
  return count;
}

std::size_t SopCatalog::near(const Eigen::Vector3d& p_e_m, double radius_m,
                             std::span<const SopSource*> out) const noexcept {
  const auto distance = [&](const SopSource& source) noexcept { return (source.position->value - p_e_m).norm(); };
  std::size_t count = 0, kept = 0;
  for (const SopSource& source : sources_) {
    if (!source.position || !(distance(source) <= radius_m)) continue;
    ++count;
    const auto place =
        std::upper_bound(out.begin(), out.begin() + static_cast<std::ptrdiff_t>(kept), distance(source),
                         [&](double d, const SopSource* other) noexcept { return d < distance(*other); });
    const auto at = static_cast<std::size_t>(place - out.begin());
    if (at >= out.size()) continue;
    if (kept < out.size()) ++kept;
    for (std::size_t i = kept - 1; i > at; --i) out[i] = out[i - 1];
    out[at] = &source;
  }
  return count;
}

bool prior(const SopSource& source, const Epoch& at, SopPrior& out) noexcept {
  const auto dt_s = at - epoch_of(source.at_us);
  if (!dt_s || !std::isfinite(*dt_s)) return false;
  SopPrior found;
  found.carrier_hz = source.carrier_hz;
  if (source.position) {
    SopPosition position = *source.position;
    position.t_s = 0.0;
    if (!age(position, kPositionWalkM2ps, *dt_s)) return false;
    found.has_position = true;
    found.p_e_m = position.value;
    found.position_covariance_m2 = position.covariance;
  }
  clock::Oscillator oscillator = clock::Oscillator::tcxo();
  if (source.noise) {
    SopNoise noise = *source.noise;
    for (int i = 0; i < 2; ++i) {
      noise.ln_covariance(i, i) = std::min(noise.ln_covariance(i, i) + kLnWalkPerS * std::abs(*dt_s), kMostLnVariance);
    }
    oscillator = noise.mean();
    oscillator.h0 = std::min(oscillator.h0, 1.0);
    oscillator.h_minus_2 = std::min(oscillator.h_minus_2, 1.0);
    found.has_noise = true;
  }
  constexpr double kC2 = kSpeedOfLightMps * kSpeedOfLightMps;
  found.noise = {0.5 * kC2 * oscillator.h0, 2.0 * kPi * kPi * kC2 * oscillator.h_minus_2};
  if (source.clock) {
    SopClock clock = *source.clock;
    clock.t_s = 0.0;
    if (!move_clock(clock, oscillator, *dt_s)) return false;
    found.has_clock = true;
    found.clock = kSpeedOfLightMps * clock.value;
    found.clock_covariance = kC2 * clock.covariance;
  }
  out = found;
  return true;
}

std::vector<std::byte> write_snapshot(std::span<const SopSource> sources, std::int64_t created_us) {
  check_time(created_us, "", "a time of its making");
  std::vector<const SopSource*> order;
  order.reserve(sources.size());
  for (const SopSource& source : sources) {
    check_source(source, "source " + source.id + ": ");
    order.push_back(&source);
  }
  std::sort(order.begin(), order.end(), [](const SopSource* a, const SopSource* b) { return a->id < b->id; });
  std::vector<std::byte> out;
  out.reserve(kHeaderBytes + kRecordBytes * order.size());
  Writer to(out);
  for (const std::uint8_t byte : kMagic) to.whole(byte);
  to.whole(kVersion);
  to.whole(static_cast<std::uint16_t>(kHeaderBytes));
  to.whole(static_cast<std::uint32_t>(kRecordBytes));
  to.whole(static_cast<std::uint64_t>(order.size()));
  to.whole(created_us);
  to.whole(std::uint32_t{0});
  to.whole(std::uint32_t{0});  // the checksum, below
  for (std::size_t i = 0; i < order.size(); ++i) {
    const SopSource& source = *order[i];
    if (i > 0 && order[i - 1]->id == source.id) refuse("source " + source.id + ": an id of its own expected");
    to.text(source.id, kIdBytes);
    to.text(source.name, kNameBytes);
    to.whole(static_cast<std::uint8_t>(source.kind));
    to.whole(static_cast<std::uint8_t>((source.position ? kHasPosition : 0U) | (source.clock ? kHasClock : 0U) |
                                       (source.noise ? kHasNoise : 0U)));
    to.whole(static_cast<std::uint8_t>(source.grade));
    to.whole(std::uint8_t{0});
    to.whole(source.contributions);
    to.real(source.carrier_hz);
    to.whole(source.newest_us);
    to.whole(source.at_us);
    SopPosition no_position;
    SopClock no_clock;
    no_position.covariance.setZero();
    no_clock.covariance.setZero();
    to.values(source.position.value_or(no_position));
    to.values(source.clock.value_or(no_clock));
    to.values(source.noise ? as_estimate(*source.noise) : no_clock);
  }
  const std::span<const std::byte> all(out);
  const std::uint32_t crc = crc32(crc32(0, all.first(kCrcAt)), all.subspan(kHeaderBytes));
  for (std::size_t i = 0; i < 4; ++i) out[kCrcAt + i] = static_cast<std::byte>((crc >> (8 * i)) & 0xFFU);
  return out;
}

}  // namespace soopnav::navigation

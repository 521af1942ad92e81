// Derivation: cpp/doc/pbch_decoding.md
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "soopnav/waveform/lte/pbch.hpp"
#include "soopnav/waveform/lte/sequences.hpp"
#include "waveform/lte/pbch_code.hpp"
#include "waveform/lte/viterbi.hpp"

namespace soopnav::lte {
namespace {

using detail::CodedWord;
using detail::kCodedBits;
using detail::kMibBits;

// Longest run of frames combined, and the 40 ms periods it may touch.
constexpr std::size_t kMaxWindow = 32;
constexpr std::size_t kMaxPeriods = kMaxWindow / 4 + 1;

// Least margin: eq. 4 of the derivation, for a false-alarm rate of 5e-6 in the first eight frames and as much in the
// rest.
constexpr std::size_t kFirstWindow = 8;
constexpr float kFirstMargin = 7.7F;
constexpr float kLaterMargin = 8.15F;
// Least margin of a word from one period while others are at hand: a wrong counter differs in few coded bits.
constexpr float kAloneMargin = 11.0F;
constexpr int kMaxAttempts = 2000;

// Two more tests for soft bits that hold a signal, but another than the one sought (doc section 3): the least share of
// the correlation that the soft bits promise, and the most that bits of the wrong sign may hold.
constexpr float kLeastShare = 0.6F;
constexpr float kShareSlack = 2.0F;
constexpr float kMostDisagreement = 2.4F;

using Buffer = std::array<float, kCodedBits>;

inline float with_sign(float x, std::uint32_t negative) noexcept {
  return std::bit_cast<float>(std::bit_cast<std::uint32_t>(x) ^ (negative << 31));
}

/// Sum of the soft values, each with the sign its bit of the word asks for.
float correlate(const Buffer& soft, const CodedWord& word) noexcept {
  float sum = 0.0F;
  for (std::size_t i = 0; i < kCodedBits; ++i) sum += with_sign(soft[i], word.bit(i) ? 1U : 0U);
  return sum;
}

/// What a soft bit that is a true log-likelihood ratio adds to the right word's correlation, on average: |L| tanh(|L| /
/// 2).
inline float expected_correlation(float soft) noexcept {
  const float y = 0.5F * std::abs(soft);
  const float tanh = y * (27.0F + y * y) / (27.0F + 9.0F * y * y);  // within 0.024, and 1 at y = 3
  return 2.0F * y * (y < 3.0F ? tanh : 1.0F);
}

/// Soft bits summed into the circular buffer, and what they promise.
struct Sum {
  Buffer soft{};
  float energy = 0.0F;    // sum of squares of the single soft bits
  float expected = 0.0F;  // of the right word's correlation
};

/// Near-maximum-likelihood search among the 2^24 words whose CRC holds (ordered statistics, order three): decides the
/// 24 most reliable independent bits by sign, then tries every change of up to three of them.
class OrderedStatistics {
 public:
  /// The best word's 24 payload bits. `mask` is the word of the ports' CRC mask.
  std::uint32_t decode(const Buffer& soft, const CodedWord& mask) noexcept {
    CodedWord hard = mask;
    std::array<std::uint32_t, kCodedBits> order;
    for (std::size_t i = 0; i < kCodedBits; ++i) {
      const auto bits = std::bit_cast<std::uint32_t>(soft[i]);
      if ((bits >> 31) != 0U) hard.part[i / 64] ^= std::uint64_t{1} << (i % 64);
      magnitude_[i] = std::abs(soft[i]);
      order[i] = (bits & 0x7FFFFF80U) | static_cast<std::uint32_t>(i);  // magnitudes sort like integers
    }
    std::sort(order.begin(), order.end(), [](std::uint32_t a, std::uint32_t b) { return a > b; });
    fill_table();

    for (std::size_t i = 0; i < kMibBits; ++i) rows_[i] = {detail::kBasis[i], 1U << i};
    Row base{};
    std::array<bool, kMibBits> negative{};
    std::size_t rank = 0;
    for (std::size_t k = 0; k < kCodedBits && rank < kMibBits; ++k) {
      const std::size_t place = order[k] & 127U;
      std::size_t pivot = rank;
      while (pivot < kMibBits && !rows_[pivot].word.bit(place)) ++pivot;
      if (pivot == kMibBits) continue;  // depends on the places already taken
      std::swap(rows_[rank], rows_[pivot]);
      for (std::size_t i = 0; i < kMibBits; ++i) {
        if (i != rank && rows_[i].word.bit(place)) add(rows_[i], rows_[rank]);
      }
      cost_[rank] = magnitude_[place];
      negative[rank] = hard.bit(place);
      ++rank;
    }
    for (std::size_t i = 0; i < kMibBits; ++i) {
      if (negative[i]) add(base, rows_[i]);
    }
    base.word ^= hard;  // from here on: where the candidate disagrees with the signs

    best_ = base.payload;
    best_penalty_ = penalty(base.word);
    extend(base, kMibBits, 0.0F, 3);
    return best_;
  }

 private:
  struct Row {
    CodedWord word;
    std::uint32_t payload = 0;
  };

  static void add(Row& a, const Row& b) noexcept {
    a.word ^= b.word;
    a.payload ^= b.payload;
  }

  // Changes one more of the decided bits below `end`, least reliable first. A change costs at least its own magnitude.
  void extend(const Row& from, std::size_t end, float cost, int depth) noexcept {
    for (std::size_t i = end; i-- > 0;) {
      const float cost_here = cost + cost_[i];
      if (cost_here >= best_penalty_) break;  // the others are no cheaper
      Row candidate = from;
      add(candidate, rows_[i]);
      const float p = penalty(candidate.word);
      if (p < best_penalty_) {
        best_penalty_ = p;
        best_ = candidate.payload;
      }
      if (depth > 1) extend(candidate, i, cost_here, depth - 1);
    }
  }

  // Sums of magnitudes for each value of each byte of a word.
  void fill_table() noexcept {
    for (std::size_t byte = 0; byte < kCodedBits / 8; ++byte) {
      auto& sums = table_[byte];
      sums[0] = 0.0F;
      for (std::size_t bit = 0; bit < 8; ++bit) {
        const std::size_t half = std::size_t{1} << bit;
        const float m = magnitude_[8 * byte + bit];
        for (std::size_t i = 0; i < half; ++i) sums[half + i] = sums[i] + m;
      }
    }
  }

  [[nodiscard]] float penalty(const CodedWord& differs) const noexcept {
    float sum = 0.0F;
    for (std::size_t byte = 0; byte < kCodedBits / 8; ++byte) {
      sum += table_[byte][(differs.part[byte / 8] >> (8 * (byte % 8))) & 0xFFU];
    }
    return sum;
  }

  std::array<Row, kMibBits> rows_{};
  std::array<float, kMibBits> cost_{};
  Buffer magnitude_{};
  std::array<std::array<float, 256>, kCodedBits / 8> table_{};
  std::uint32_t best_ = 0;
  float best_penalty_ = 0.0F;
};

/// How the counter of the first period may differ from those of the next ones: counter ^ (counter + t), t = 0, 1, ...
using CarryPattern = std::array<std::uint8_t, kMaxPeriods>;

std::vector<CarryPattern> make_patterns(std::size_t n_periods) {
  std::vector<CarryPattern> patterns;
  for (unsigned counter = 0; counter < 256; ++counter) {
    CarryPattern pattern{};
    for (unsigned t = 0; t < n_periods; ++t) pattern[t] = static_cast<std::uint8_t>(counter ^ (counter + t));
    if (std::find(patterns.begin(), patterns.end(), pattern) == patterns.end()) patterns.push_back(pattern);
  }
  return patterns;
}

}  // namespace

struct PbchDecoder::Scratch {
  detail::TailBitingViterbi viterbi;
  OrderedStatistics ordered;
  std::array<std::vector<CarryPattern>, kMaxPeriods + 1> patterns;  // by number of periods
  std::array<CodedWord, 256> counter_word{};                        // coded difference of two counters
  std::array<std::uint32_t, 60> scrambling{};
  std::array<std::array<Sum, kMaxPeriods>, 4> periods;        // of the window, descrambled for each phase
  std::array<std::pair<float, float>, kMaxWindow> promise{};  // energy and expected correlation of the window's frames
  Sum combined;
  Buffer by_time{};
  int n_ports = 1;
  int attempts = 0;
  CodedWord mask;

  Scratch() {
    for (std::size_t n = 1; n <= kMaxPeriods; ++n) patterns[n] = make_patterns(n);
    for (unsigned d = 0; d < 256; ++d) counter_word[d] = detail::encode_linear(detail::place_counter(d));
  }

  /// Sums the window's frames by period, for each phase of the first one.
  void combine(std::span<const PbchSoftBits> frames, std::size_t bits_per_frame) noexcept {
    for (std::size_t f = 0; f < frames.size(); ++f) {
      auto& [energy, expected] = promise[f];
      energy = 0.0F;
      expected = 0.0F;
      for (std::size_t i = 0; i < bits_per_frame; ++i) {
        energy += frames[f][i] * frames[f][i];
        expected += expected_correlation(frames[f][i]);
      }
    }
    for (std::size_t phase = 0; phase < 4; ++phase) {
      for (std::size_t t = 0; t < periods_of(phase, frames.size()); ++t) periods[phase][t] = Sum{};
      for (std::size_t f = 0; f < frames.size(); ++f) {
        if (!std::isfinite(promise[f].first)) continue;  // NaN in means not used
        Sum& sum = periods[phase][(phase + f) / 4];
        sum.energy += promise[f].first;
        sum.expected += promise[f].second;
        const std::size_t first = ((phase + f) % 4) * bits_per_frame;
        std::size_t place = first % kCodedBits;
        for (std::size_t i = 0; i < bits_per_frame; ++i) {
          const std::size_t n = first + i;
          sum.soft[place] += with_sign(frames[f][i], (scrambling[n / 32] >> (n % 32)) & 1U);
          if (++place == kCodedBits) place = 0;
        }
      }
    }
  }

  /// Periods that a window touches when its first frame is the `phase`-th of its period.
  static std::size_t periods_of(std::size_t phase, std::size_t n_frames) noexcept { return (phase + n_frames + 3) / 4; }

  /// The payload in `combined`, when a word with a right CRC has at least `margin` and nothing speaks against it.
  std::optional<std::uint32_t> attempt(float margin) noexcept {
    ++attempts;
    const Buffer& soft = combined.soft;
    const float sigma = std::sqrt(combined.energy);  // of a word's correlation without signal
    const float least = std::max(margin * sigma, kLeastShare * combined.expected - kShareSlack * sigma);
    if (!(least > 0.0F)) return std::nullopt;
    for (std::size_t i = 0; i < kCodedBits; ++i) by_time[detail::kCircularOrder[i]] = soft[i];
    if (viterbi.start(by_time) < least) return std::nullopt;  // no word of the code reaches it
    const std::uint64_t bits = viterbi.finish(by_time).bits;
    auto payload = static_cast<std::uint32_t>(bits & 0xFFFFFFU);
    const auto parity = static_cast<std::uint32_t>(bits >> kMibBits);
    const bool likeliest = (detail::crc16(payload) ^ detail::crc_mask(n_ports)) == parity;
    if (!likeliest) payload = ordered.decode(soft, mask);
    const float found = correlate(soft, detail::encode_linear(payload) ^ mask);
    if (found < least) return std::nullopt;
    float all = 0.0F;
    for (const float x : soft) all += std::abs(x);
    if (all - found > 2.0F * kMostDisagreement * sigma) return std::nullopt;
    if (likeliest) return payload;
    // Soft bits of another number of ports lean to a word under its mask, and some word under this mask is near it.
    for (const int other : {1, 2, 4}) {
      if (other == n_ports) continue;
      const CodedWord other_mask = detail::mask_word(other);
      const std::uint32_t rival = ordered.decode(soft, other_mask);
      if (correlate(soft, detail::encode_linear(rival) ^ other_mask) > found) return std::nullopt;
    }
    return payload;
  }

  /// Margin of a payload that `attempt` gave.
  [[nodiscard]] double margin_of(std::uint32_t payload) const noexcept {
    return static_cast<double>(correlate(combined.soft, detail::encode_linear(payload) ^ mask) /
                               std::sqrt(combined.energy));
  }
};

PbchDecoder::PbchDecoder() : scratch_(std::make_unique<Scratch>()) {}
PbchDecoder::~PbchDecoder() = default;
PbchDecoder::PbchDecoder(PbchDecoder&&) noexcept = default;
PbchDecoder& PbchDecoder::operator=(PbchDecoder&&) noexcept = default;

std::optional<PbchResult> PbchDecoder::decode(std::span<const PbchSoftBits> frames, int cell_id, CyclicPrefix cp,
                                              int n_ports) {
  if (cell_id < 0 || cell_id >= kCells || (n_ports != 1 && n_ports != 2 && n_ports != 4)) return std::nullopt;
  Scratch& s = *scratch_;
  s.n_ports = n_ports;
  s.mask = detail::mask_word(n_ports);
  s.attempts = 0;
  GoldSequence c(static_cast<std::uint32_t>(cell_id));
  for (std::uint32_t& word : s.scrambling) word = c.next_word();
  const auto bits_per_frame = static_cast<std::size_t>(pbch_bits_per_frame(cp));

  // What a payload of the period `t` of a window says, if it says anything.
  const auto result = [&](std::uint32_t payload, std::size_t first, std::size_t phase,
                          std::size_t t) -> std::optional<PbchResult> {
    MibBits bits{};
    for (std::size_t i = 0; i < bits.size(); ++i) bits[i] = static_cast<std::uint8_t>((payload >> i) & 1U);
    const auto mib = unpack_mib(bits);
    if (!mib) return std::nullopt;
    PbchResult out{*mib, n_ports, s.margin_of(payload)};
    const int back = static_cast<int>(4 * t + first) - static_cast<int>(phase);  // frames since frames[0]
    out.mib.sfn = ((mib->sfn - back) % 1024 + 1024) % 1024;
    return out;
  };

  const auto search_window = [&](std::size_t first, std::size_t length, float margin) -> std::optional<PbchResult> {
    const auto window = frames.subspan(first, length);
    s.combine(window, bits_per_frame);
    // Each period alone: enough for strong signals, and no carry to guess.
    for (std::size_t phase = 0; phase < 4; ++phase) {
      const std::size_t n_periods = Scratch::periods_of(phase, length);
      for (std::size_t t = 0; t < n_periods && s.attempts < kMaxAttempts; ++t) {
        s.combined = s.periods[phase][t];
        // Below this a word has to agree with the other periods too, which the patterns below see to.
        const auto payload = s.attempt(n_periods > 1 ? std::max(margin, kAloneMargin) : margin);
        if (!payload) continue;
        if (const auto out = result(*payload, first, phase, t)) return out;
      }
    }
    for (std::size_t phase = 0; phase < 4; ++phase) {
      const std::size_t n_periods = Scratch::periods_of(phase, length);
      if (n_periods < 2) continue;
      for (const CarryPattern& pattern : s.patterns[n_periods]) {
        if (s.attempts >= kMaxAttempts) return std::nullopt;
        s.combined = s.periods[phase][0];
        for (std::size_t t = 1; t < n_periods; ++t) {
          const CodedWord& flips = s.counter_word[pattern[t]];
          const Sum& period = s.periods[phase][t];
          s.combined.energy += period.energy;
          s.combined.expected += period.expected;
          for (std::size_t i = 0; i < kCodedBits; ++i) {
            s.combined.soft[i] += with_sign(period.soft[i], flips.bit(i) ? 1U : 0U);
          }
        }
        const auto payload = s.attempt(margin);
        if (!payload) continue;
        // A wrong pattern may leave a word that the stronger periods alone support: its counter belies the pattern.
        const unsigned counter = detail::read_counter(*payload);
        bool consistent = true;
        for (unsigned t = 0; t < n_periods; ++t) {
          consistent = consistent && static_cast<std::uint8_t>(counter ^ (counter + t)) == pattern[t];
        }
        if (!consistent) continue;
        if (const auto out = result(*payload, first, phase, 0)) return out;
      }
    }
    return std::nullopt;
  };

  // Short windows first; longer ones only where they hold more frames. Blocks of kMaxWindow until the attempts run out.
  for (std::size_t block = 0; block < frames.size(); block += kMaxWindow) {
    const std::size_t in_block = std::min(kMaxWindow, frames.size() - block);
    for (std::size_t length = kFirstWindow; length <= kMaxWindow; length *= 2) {
      for (std::size_t offset = 0; offset < in_block; offset += length / 2) {
        const std::size_t here = std::min(length, frames.size() - block - offset);
        const bool first = block == 0 && offset == 0 && length == kFirstWindow;
        if (const auto out = search_window(block + offset, here, first ? kFirstMargin : kLaterMargin)) return out;
        if (s.attempts >= kMaxAttempts) return std::nullopt;
        if (block + offset + here == frames.size()) break;  // nothing new further on
      }
      if (length >= in_block) break;
    }
  }
  return std::nullopt;
}

}  // namespace soopnav::lte

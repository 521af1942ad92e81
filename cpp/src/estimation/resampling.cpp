#include "soopnav/estimation/resampling.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "soopnav/core/packet_math.hpp"
#include "soopnav/estimation/particle_loop.hpp"

namespace soopnav {

std::string_view to_string(Resampling scheme) noexcept {
  switch (scheme) {
    case Resampling::kMultinomial:
      return "multinomial";
    case Resampling::kResidual:
      return "residual";
    case Resampling::kStratified:
      return "stratified";
    case Resampling::kSystematic:
      return "systematic";
    case Resampling::kNearest:
      return "nearest";
  }
  return "unknown";
}

namespace detail {
namespace {

// Running sums of a chunk, in four strands of their own so that one addition need not wait for the one before it.
// The strands' offsets are added last, so every machine adds in the same order.
constexpr std::size_t kStrand = kParticleChunk / 4;
static_assert(kParticleChunk % 32 == 0);

void running_sums(const double* w, double base, double* sums) noexcept {
  double a = 0.0;
  double b = 0.0;
  double c = 0.0;
  double d = 0.0;
  for (std::size_t i = 0; i < kStrand; ++i) {
    sums[i] = a += w[i];
    sums[kStrand + i] = b += w[kStrand + i];
    sums[2 * kStrand + i] = c += w[2 * kStrand + i];
    sums[3 * kStrand + i] = d += w[3 * kStrand + i];
  }
  const double at[4] = {base, base + a, (base + a) + b, ((base + a) + b) + c};
  for (std::size_t s = 0; s < 4; ++s) {
    for (std::size_t i = 0; i < kStrand; ++i) sums[s * kStrand + i] += at[s];
  }
}

// Number of systematic positions (j + offset) / scale below each sum, ceil(sum * scale - offset) in begin ... end: as
// whole numbers in the lowest bits of doubles (2^52 added).
SOOPNAV_INLINE void count_below(const double* sums, double scale, double offset, std::int32_t begin, std::int32_t end,
                                std::uint64_t* ends) noexcept {
  using P = Packet<double>;
  const P low(begin);
  const P high(end);
  for (std::size_t i = 0; i < kParticleChunk; i += P::kWidth) {
    const P v = min(max(P::load(sums + i) * P(scale) - P(offset), low), high);
    const P shifted = v + P(0x1p52);
    const P nearest = shifted - P(0x1p52);
    const P up = select(nearest < v, shifted + P(1), shifted);
    up.store_bits(ends + i);
  }
}

void count_below_portable(const double* sums, double scale, double offset, std::int32_t begin, std::int32_t end,
                          std::uint64_t* ends) noexcept {
  count_below(sums, scale, offset, begin, end, ends);
}
#if SOOPNAV_WIDE_LOOPS
[[gnu::flatten, gnu::target("avx2")]] void count_below_wide(const double* sums, double scale, double offset,
                                                            std::int32_t begin, std::int32_t end,
                                                            std::uint64_t* ends) noexcept {
  count_below(sums, scale, offset, begin, end, ends);
}
#endif

}  // namespace

std::int32_t chunk_boundary(double sum, double scale, double offset, std::int32_t count) noexcept {
  return static_cast<std::int32_t>(std::clamp(std::ceil(sum * scale - offset), 0.0, static_cast<double>(count)));
}

void share_chunk(const ChunkShare& share, std::uint32_t* ancestors) noexcept {
  if (share.begin >= share.end) return;
  std::array<double, kParticleChunk> weights;
  std::array<double, kParticleChunk> sums;
  std::array<std::uint64_t, kParticleChunk> ends;
  const double* w = share.weights;
  if (share.n < kParticleChunk) {
    std::copy_n(w, share.n, weights.begin());
    std::fill(weights.begin() + static_cast<std::ptrdiff_t>(share.n), weights.end(), 0.0);
    w = weights.data();
  }
  running_sums(w, share.base, sums.data());
#if SOOPNAV_WIDE_LOOPS
  const auto count = has_wide_loops() ? count_below_wide : count_below_portable;
#else
  const auto count = count_below_portable;
#endif
  count(sums.data(), share.scale, share.offset, share.begin, share.end, ends.data());
  const auto end_of = [&ends](std::size_t i) noexcept { return static_cast<std::int32_t>(ends[i]); };
  // Rounding may leave the last outputs to nobody, or to a particle without weight: they belong to the last one with.
  std::size_t last = share.n - 1;
  while (last > 0 && !(share.weights[last] > 0.0)) --last;
  for (std::size_t i = last; i < share.n; ++i) ends[i] = static_cast<std::uint64_t>(share.end);
  // Each particle writes four copies of itself over what will be the next ones' share: no branch while counts are
  // small.
  std::int32_t at = share.begin;
  std::size_t i = 0;
  for (; i < share.n && at + 4 <= share.end; ++i) {
    const auto ancestor = share.first + static_cast<std::uint32_t>(i);
    const std::int32_t stop = end_of(i);
    for (std::int32_t k = 0; k < 4; ++k) ancestors[at + k] = ancestor;
    for (std::int32_t j = at + 4; j < stop; ++j) ancestors[j] = ancestor;
    at = stop;
  }
  for (; i < share.n; ++i) {
    for (; at < end_of(i); ++at) ancestors[at] = share.first + static_cast<std::uint32_t>(i);
  }
  for (; at < share.end; ++at) ancestors[at] = share.first + static_cast<std::uint32_t>(last);
}

}  // namespace detail

namespace {

constexpr std::size_t kBlock = 256;

// Sum of the weights, chunk by chunk; NaN when a weight is negative or NaN. `last` is the last positive weight.
double checked_sum(std::span<const double> weights, std::size_t& last) noexcept {
  double total = 0.0;
  bool sound = true;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    sound = sound && weights[i] >= 0.0;
    last = weights[i] > 0.0 ? i : last;
    total += weights[i];
  }
  return sound ? total : std::numeric_limits<double>::quiet_NaN();
}

// Walks positions and running sums together. Each turn either gives an output to the present particle or goes to the
// next one, without a branch on which.
class Merge {
 public:
  Merge(std::span<const double> weights, std::size_t last) noexcept
      : weights_(weights), last_(last), sum_(weights[0]) {}

  // Gives `positions`, ascending, to their particles, as `ancestors`.
  void take(std::span<const double> positions, std::uint32_t* ancestors) noexcept {
    std::size_t j = 0;
    while (j < positions.size()) {
      const bool here = (sum_ > positions[j]) | (at_ == last_);
      ancestors[j] = static_cast<std::uint32_t>(at_);
      j += static_cast<std::size_t>(here);
      at_ += static_cast<std::size_t>(!here);
      sum_ += here ? 0.0 : weights_[at_];
    }
  }

 private:
  std::span<const double> weights_;
  std::size_t last_;
  std::size_t at_ = 0;
  double sum_;
};

// Blocks of exponential variates from `random`, padded with zeros; `use(block, n)`.
template <class Use>
void exponentials(RandomStream random, std::size_t count, Use use) noexcept {
  std::array<double, kBlock> e;
  for (std::size_t done = 0; done < count;) {
    const std::size_t n = std::min(kBlock, count - done);
    random.fill_uniform(std::span(e).first(n));
    std::fill(e.begin() + static_cast<std::ptrdiff_t>(n), e.end(), 0.0);
    for (std::size_t i = 0; i < kBlock; i += Packet<double>::kWidth) {
      const auto u = Packet<double>::load(&e[i]);
      (-log(Packet<double>(1.0) - u)).store(&e[i]);  // u < 1
    }
    use(std::span<const double>(e).first(n));
    done += n;
  }
}

// Positions of `count` sorted uniforms on [0, total): sums of exponentials over the sum of one more of them, drawn
// twice rather than kept (Devroye, Non-Uniform Random Variate Generation, V.3.1).
void multinomial(std::span<const double> weights, double total, std::size_t last, RandomStream& random,
                 std::span<std::uint32_t> ancestors) noexcept {
  const std::size_t count = ancestors.size();
  double whole = 0.0;
  exponentials(random, count + 1, [&whole](std::span<const double> e) {
    for (const double x : e) whole += x;
  });
  Merge merge(weights, last);
  double sum = 0.0;
  std::size_t done = 0;
  std::array<double, kBlock> positions;
  const double scale = total / whole;
  exponentials(random, count, [&](std::span<const double> e) {
    for (std::size_t i = 0; i < e.size(); ++i) {
      sum += e[i];
      positions[i] = sum * scale;
    }
    merge.take(std::span<const double>(positions).first(e.size()), ancestors.data() + done);
    done += e.size();
  });
  random.skip(count + 1);
}

// What is left of a weight after its whole offspring.
struct Split {
  double whole;
  double rest;
};
Split split(double weight, double scale) noexcept {
  const double expected = weight * scale;
  const double whole = std::floor(expected);
  return {whole, expected - whole};
}

// floor(N w) copies of each, then multinomial draws from what is left of the weights, merged in ascending order.
void residual(std::span<const double> weights, double total, RandomStream& random,
              std::span<std::uint32_t> ancestors) noexcept {
  const std::size_t count = ancestors.size();
  const double scale = static_cast<double>(count) / total;
  double copies = 0.0;
  double left = 0.0;
  std::size_t last = 0;
  for (std::size_t i = 0; i < weights.size(); ++i) {
    const Split s = split(weights[i], scale);
    copies += s.whole;
    left += s.rest;
    last = s.rest > 0.0 ? i : last;
  }
  const auto kept = static_cast<std::size_t>(std::min(copies, static_cast<double>(count)));
  const std::size_t drawn = count - kept;
  double spacing = 0.0;
  if (drawn > 0) {
    exponentials(random, drawn + 1, [&spacing](std::span<const double> e) {
      for (const double x : e) spacing += x;
    });
  }
  // One walk over the particles; the next sorted uniform waits in `position`.
  std::array<double, kBlock> e{};
  RandomStream draws = random;
  std::size_t used = 0;
  double reached = 0.0;
  const auto next_position = [&]() noexcept {
    if (used % kBlock == 0) {
      exponentials(draws, std::min(kBlock, drawn - used),
                   [&e](std::span<const double> block) { std::copy(block.begin(), block.end(), e.begin()); });
      draws.skip(std::min(kBlock, drawn - used));
    }
    reached += e[used % kBlock];
    ++used;
    return reached * (left / spacing);
  };
  std::size_t out = 0;
  std::size_t waiting = drawn;
  double position = drawn > 0 ? next_position() : 0.0;
  double sum = 0.0;
  for (std::size_t i = 0; i < weights.size() && out < count; ++i) {
    const Split s = split(weights[i], scale);
    for (auto k = static_cast<std::size_t>(s.whole); k > 0 && out < count; --k) {
      ancestors[out++] = static_cast<std::uint32_t>(i);
    }
    sum += s.rest;
    while (waiting > 0 && (position < sum || i == last) && out < count && s.rest > 0.0) {
      ancestors[out++] = static_cast<std::uint32_t>(i);
      --waiting;
      if (waiting > 0) position = next_position();
    }
  }
  if (drawn > 0) random.skip(drawn + 1);
}

// Positions block by block, one uniform in each stratum.
void stratified(std::span<const double> weights, double total, std::size_t last, RandomStream& random,
                std::span<std::uint32_t> ancestors) noexcept {
  const double width = total / static_cast<double>(ancestors.size());
  Merge merge(weights, last);
  std::array<double, kBlock> positions;
  for (std::size_t done = 0; done < ancestors.size();) {
    const std::size_t n = std::min(kBlock, ancestors.size() - done);
    random.fill_uniform(std::span(positions).first(n));
    for (std::size_t i = 0; i < n; ++i) positions[i] = (static_cast<double>(done + i) + positions[i]) * width;
    merge.take(std::span<const double>(positions).first(n), ancestors.data() + done);
    done += n;
  }
}

void systematic(std::span<const double> weights, double total, std::size_t last, RandomStream& random,
                std::span<std::uint32_t> ancestors) noexcept {
  const auto count = static_cast<std::int32_t>(ancestors.size());
  const double scale = static_cast<double>(count) / total;
  const double offset = random.uniform();
  double base = 0.0;
  std::int32_t begin = 0;
  for (std::size_t first = 0; first < weights.size() && begin < count; first += detail::kParticleChunk) {
    const std::size_t n = std::min(detail::kParticleChunk, weights.size() - first);
    double sum = 0.0;
    for (std::size_t i = 0; i < n; ++i) sum += weights[first + i];
    const double next = base + sum;
    const std::int32_t end = first + n > last ? count : detail::chunk_boundary(next, scale, offset, count);
    detail::share_chunk({weights.data() + first, n, base, scale, offset, static_cast<std::uint32_t>(first), begin, end},
                        ancestors.data());
    base = next;
    begin = end;
  }
}

// min(abs(cumulative - position)): the entry of the cumulative sum that is nearest, ties to the first.
void nearest(std::span<const double> weights, double total, RandomStream& random,
             std::span<std::uint32_t> ancestors) noexcept {
  const double step = total / static_cast<double>(ancestors.size());
  const double offset = random.uniform();
  std::size_t i = 0;
  std::size_t best = 0;  // the first of the entries equal to `sum`
  double sum = weights[0];
  for (std::size_t j = 0; j < ancestors.size(); ++j) {
    const double position = (static_cast<double>(j) + offset) * step;
    while (i + 1 < weights.size()) {
      const double next = sum + weights[i + 1];
      if (next > sum && !(std::abs(next - position) < std::abs(sum - position))) break;
      ++i;
      best = next > sum ? i : best;
      sum = next;
    }
    ancestors[j] = static_cast<std::uint32_t>(best);
  }
}

}  // namespace

bool resample(Resampling scheme, std::span<const double> weights, RandomStream& random,
              std::span<std::uint32_t> ancestors) noexcept {
  constexpr std::size_t kMost = std::numeric_limits<std::int32_t>::max();
  std::size_t last = 0;
  const double total = checked_sum(weights, last);
  if (!(total > 0.0) || std::isinf(total) || weights.size() > kMost || ancestors.size() > kMost) return false;
  if (ancestors.empty()) return true;
  switch (scheme) {
    case Resampling::kMultinomial:
      multinomial(weights, total, last, random, ancestors);
      return true;
    case Resampling::kResidual:
      residual(weights, total, random, ancestors);
      return true;
    case Resampling::kStratified:
      stratified(weights, total, last, random, ancestors);
      return true;
    case Resampling::kSystematic:
      systematic(weights, total, last, random, ancestors);
      return true;
    case Resampling::kNearest:
      nearest(weights, total, random, ancestors);
      return true;
  }
  return false;
}

}  // namespace soopnav

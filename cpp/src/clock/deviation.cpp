#include "soopnav/clock/deviation.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/estimation/chi_square.hpp"

namespace soopnav::clock {
namespace {

// Sum of squares and how many.
struct Terms {
  double sum = 0.0;
  std::size_t count = 0;

  void add(double difference) {
    const double square = difference * difference;
    if (square == square) sum += square, ++count;  // a NaN is a gap
  }
};

// Squares of `at(0), at(stride), ...` below `end`; eight sums side by side, since one would wait for itself, and two of
// them fit in a register.
template <class At>
Terms squares(std::size_t end, std::size_t stride, bool gaps, const At& at) {
  Terms terms;
  if (gaps) {
    for (std::size_t i = 0; i < end; i += stride) terms.add(at(i));
    return terms;
  }
  std::array<double, 8> sums{};
  std::size_t i = 0;
  if (stride == 1) {
    for (; i + 8 <= end; i += 8) {
      for (std::size_t j = 0; j < 8; ++j) {
        const double d = at(i + j);
        sums[j] += d * d;
      }
    }
    terms.count = i;
  }
  for (; i < end; i += stride, ++terms.count) sums[0] += at(i) * at(i);
  for (const double sum : sums) terms.sum += sum;
  return terms;
}

// Sums of m neighbouring second differences, each moved on from the last.
Terms modified_terms(std::span<const double> x, std::size_t m) {
  Terms terms;
  if (x.size() < 3 * m) return terms;
  const auto second = [x, m](std::size_t i) { return (x[i + 2 * m] - x[i + m]) - (x[i + m] - x[i]); };
  double window = 0.0;
  std::size_t missing = 0;
  const auto change = [&](double d, double sign) {
    if (d == d) {
      window += sign * d;
    } else {
      missing += sign > 0.0 ? 1 : std::size_t(-1);
    }
  };
  for (std::size_t i = 0; i < m; ++i) change(second(i), 1.0);
  const std::size_t last = x.size() - 3 * m;
  for (std::size_t j = 0;; ++j) {
    if (missing == 0) terms.add(window);
    if (j == last) return terms;
    change(second(j), -1.0);
    change(second(j + m), 1.0);
  }
}

struct Segment {
  std::vector<double> own;
  std::span<const double> x;
  bool gaps = false;
};

Terms terms_of(const Segment& segment, DeviationKind kind, std::size_t m) {
  const auto x = segment.x;
  const std::size_t n = x.size();
  switch (kind) {
    case DeviationKind::kModifiedAllan:
    case DeviationKind::kTime:
      return modified_terms(x, m);
    case DeviationKind::kHadamard:
    case DeviationKind::kOverlappingHadamard: {
      if (n / 3 < m || n <= 3 * m) return {};
      const double* p = x.data();
      return squares(n - 3 * m, kind == DeviationKind::kHadamard ? m : 1, segment.gaps,
                     [p, m](std::size_t i) { return (p[i + 3 * m] - p[i]) - 3.0 * (p[i + 2 * m] - p[i + m]); });
    }
    case DeviationKind::kAllan:
    case DeviationKind::kOverlappingAllan: {
      if (n / 2 < m || n <= 2 * m) return {};
      const double* p = x.data();
      return squares(n - 2 * m, kind == DeviationKind::kAllan ? m : 1, segment.gaps,
                     [p, m](std::size_t i) { return (p[i + 2 * m] - p[i + m]) - (p[i + m] - p[i]); });
    }
  }
  return {};
}

// From the mean square of the differences to the deviation: SP 1065 eqs. 9, 11, 13, 15, 19 and 21.
double scaled(double mean_square, DeviationKind kind, std::size_t factor, double tau_s) {
  switch (kind) {
    case DeviationKind::kHadamard:
    case DeviationKind::kOverlappingHadamard:
      return std::sqrt(mean_square / 6.0) / tau_s;
    case DeviationKind::kModifiedAllan:
      return std::sqrt(mean_square / 2.0) / (tau_s * static_cast<double>(factor));
    case DeviationKind::kTime:
      return std::sqrt(mean_square / 6.0) / static_cast<double>(factor);
    case DeviationKind::kAllan:
    case DeviationKind::kOverlappingAllan:
      break;
  }
  return std::sqrt(mean_square / 2.0) / tau_s;
}

void check(double dt_s, std::span<const std::size_t> factors, const DeviationOptions& options) {
  if (!(dt_s > 0.0) || std::isinf(dt_s)) {
    throw std::invalid_argument("dt_s = " + std::to_string(dt_s) + " must be positive and finite");
  }
  if (!(options.confidence > 0.0 && options.confidence < 1.0)) {
    throw std::invalid_argument("confidence = " + std::to_string(options.confidence) + " must be between 0 and 1");
  }
  for (std::size_t i = 0; i < factors.size(); ++i) {
    if (factors[i] < 1) throw std::invalid_argument("factors[" + std::to_string(i) + "] = 0: at least 1 expected");
  }
}

void refuse_infinite(std::span<const double> values, const char* name) {
  const auto bad = std::find_if(values.begin(), values.end(), [](double v) { return std::isinf(v); });
  if (bad != values.end()) {
    throw std::invalid_argument(std::string(name) + "[" + std::to_string(bad - values.begin()) +
                                "] is infinite: finite numbers expected, NaN for a gap");
  }
}

std::vector<Deviation> deviations(const std::vector<Segment>& segments, double dt_s, DeviationKind kind,
                                  std::span<const std::size_t> factors, const DeviationOptions& options) {
  std::vector<Deviation> out;
  out.reserve(factors.size());
  const auto longest = std::max_element(segments.begin(), segments.end(),
                                        [](const Segment& a, const Segment& b) { return a.x.size() < b.x.size(); });
  PowerLaw noise = options.noise.value_or(PowerLaw::kWhiteFrequency);
  for (const std::size_t m : factors) {
    Terms terms;
    for (const Segment& segment : segments) {
      const Terms more = terms_of(segment, kind, m);
      terms.sum += more.sum;
      terms.count += more.count;
    }
    if (terms.count == 0) continue;
    // Where too little is left to tell, the noise is that of the averaging time before.
    if (!options.noise) noise = identify_noise(longest->x, m, kind).value_or(noise);
    Deviation d;
    d.tau_s = static_cast<double>(m) * dt_s;
    d.count = terms.count;
    d.noise = noise;
    d.deviation = scaled(terms.sum / static_cast<double>(terms.count), kind, m, d.tau_s);
    d.dof = equivalent_dof(kind, noise, m, terms.count);
    const double beyond = 0.5 * (1.0 - options.confidence);
    d.lower = d.deviation * std::sqrt(d.dof / chi_square_upper_quantile(beyond, d.dof));
    d.upper = d.deviation * std::sqrt(d.dof / chi_square_quantile(beyond, d.dof));
    out.push_back(d);
  }
  return out;
}

}  // namespace

std::vector<std::size_t> averaging_factors(std::size_t phases, DeviationKind kind, TauSpacing spacing) {
  std::size_t most = 0;
  if (phases > 0) {
    switch (kind) {
      case DeviationKind::kModifiedAllan:
      case DeviationKind::kTime:
        most = phases / 3;
        break;
      case DeviationKind::kHadamard:
      case DeviationKind::kOverlappingHadamard:
        most = (phases - 1) / 3;
        break;
      case DeviationKind::kAllan:
      case DeviationKind::kOverlappingAllan:
        most = (phases - 1) / 2;
        break;
    }
  }
  std::vector<std::size_t> out;
  for (std::size_t m = 1, of_decade = 0; m <= most;) {
    out.push_back(m);
    if (spacing == TauSpacing::kAll) {
      ++m;
    } else if (spacing == TauSpacing::kOctave || of_decade < 2) {
      m *= 2;
      ++of_decade;
    } else {
      m = m / 4 * 10;
      of_decade = 0;
    }
  }
  return out;
}

std::vector<Deviation> phase_deviations(std::span<const double> phase_s, double dt_s, DeviationKind kind,
                                        std::span<const std::size_t> factors, const DeviationOptions& options) {
  check(dt_s, factors, options);
  refuse_infinite(phase_s, "phase_s");
  std::vector<Segment> one(1);
  one[0].x = phase_s;
  one[0].gaps = std::any_of(phase_s.begin(), phase_s.end(), [](double v) { return v != v; });
  return deviations(one, dt_s, kind, factors, options);
}

std::vector<Deviation> frequency_deviations(std::span<const double> frequency, double dt_s, DeviationKind kind,
                                            std::span<const std::size_t> factors, const DeviationOptions& options) {
  check(dt_s, factors, options);
  refuse_infinite(frequency, "frequency");
  double mean = 0.0;
  std::size_t n = 0;
  for (const double y : frequency) {
    if (y == y) mean += y, ++n;
  }
  if (n > 0) mean /= static_cast<double>(n);
  std::vector<Segment> segments;
  for (std::size_t i = 0; i < frequency.size();) {
    if (frequency[i] != frequency[i]) {
      ++i;
      continue;
    }
    std::vector<double> x{0.0};
    for (; i < frequency.size() && frequency[i] == frequency[i]; ++i) {
      x.push_back(x.back() + (frequency[i] - mean) * dt_s);  // the mean would only cost digits
    }
    segments.emplace_back();
    segments.back().own = std::move(x);
  }
  for (Segment& segment : segments) segment.x = segment.own;
  if (segments.empty()) return {};
  return deviations(segments, dt_s, kind, factors, options);
}

}  // namespace soopnav::clock

#include "soopnav/navigation/opportunistic_smoother.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <string>

#include "navigation/opportunistic_state.hpp"

// Records of a run, and its smoothing (doc/opportunistic_navigation.md section 5).
namespace soopnav::navigation {

namespace detail {

void Recorder::reserve(int epochs, int max_dim, int max_pairs, int max_noises) {
  const auto steps = static_cast<std::size_t>(epochs);
  const auto n = static_cast<std::size_t>(max_dim);
  *this = Recorder();
  capacity_ = epochs;
  steps_.reserve(2 * steps);
  // Reserved, not written: memory that no step needs is never touched.
  numbers_.reserve(steps * (2 * n + n * (n + 1) / 2));
  members_.reserve(steps * n);
  pairs_.reserve(steps * static_cast<std::size_t>(max_pairs));
  noises_.reserve(steps * static_cast<std::size_t>(max_noises));
  last_.reserve(n * n);
  active_ = true;
}

bool Recorder::begin(double t_s, double dt_s, std::span<const Member> members) noexcept {
  const std::size_t n = members.size();
  if (count_ >= capacity_ || numbers_.size() + 2 * n + n * (n + 1) / 2 > numbers_.capacity() ||
      members_.size() + n > members_.capacity() || steps_.size() == steps_.capacity()) {
    active_ = false;
    return false;
  }
  steps_.emplace_back();
  Step& step = steps_.back();
  step.t_s = t_s;
  step.dt_s = dt_s;
  step.n = static_cast<int>(n);
  step.members = members_.size();
  members_.insert(members_.end(), members.begin(), members.end());
  ++count_;
  return true;
}

void Recorder::pack(const OpportunisticFilter& filter) noexcept {
  for (int j = 0; j < filter.dim(); ++j) {
    const double* column = filter.matrix() + static_cast<std::size_t>(j) * static_cast<std::size_t>(filter.stride());
    numbers_.insert(numbers_.end(), column + j, column + filter.dim());
  }
}

void Recorder::predicted(const OpportunisticFilter& filter, std::span<const RatePair> pairs,
                         std::span<const PlaceNoise> noises) noexcept {
  Step& step = steps_.back();
  step.pairs = pairs_.size();
  step.pair_count = static_cast<int>(pairs.size());
  pairs_.insert(pairs_.end(), pairs.begin(), pairs.end());
  step.noises = noises_.size();
  step.noise_count = static_cast<int>(noises.size());
  noises_.insert(noises_.end(), noises.begin(), noises.end());
  step.predicted = numbers_.size();
  numbers_.insert(numbers_.end(), filter.x(), filter.x() + filter.dim());
  step.matrix = numbers_.size();
  pack(filter);
}

void Recorder::filtered(const OpportunisticFilter& filter) noexcept {
  steps_.back().filtered = numbers_.size();
  numbers_.insert(numbers_.end(), filter.x(), filter.x() + filter.dim());
  const auto n = static_cast<std::size_t>(filter.dim());
  last_.resize(n * n);
  filter.covariance(last_.data());
}

void Recorder::leaving(double t_s, std::span<const Member> members, const OpportunisticFilter& filter) noexcept {
  if (steps_.empty()) return;
  const std::size_t n = members.size();
  if (numbers_.size() + n + n * n > numbers_.capacity() || members_.size() + n > members_.capacity() ||
      steps_.size() == steps_.capacity()) {
    active_ = false;
    return;
  }
  steps_.emplace_back();
  Step& step = steps_.back();
  step.leave = true;
  step.t_s = t_s;
  step.n = static_cast<int>(n);
  step.members = members_.size();
  members_.insert(members_.end(), members.begin(), members.end());
  step.filtered = numbers_.size();
  numbers_.insert(numbers_.end(), filter.x(), filter.x() + n);
  step.matrix = numbers_.size();
  numbers_.resize(numbers_.size() + n * n);
  filter.covariance(numbers_.data() + step.matrix);
}

}  // namespace detail

namespace {

using detail::Member;
using detail::Recorder;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr std::size_t sized(int n) noexcept { return static_cast<std::size_t>(n); }

// A smoothed state on its way back through the records, and the gain that led to it.
class Backward {
 public:
  explicit Backward(bool gains) : with_gain(gains) {}

  const bool with_gain;
  int n = 0;
  std::vector<Member> members;
  std::vector<double> x, P;  // P column-major n x n
  std::vector<double> G;     // n x columns: from the smoothed state of the next epoch
  int columns = 0;

  double& at(int i, int j) noexcept { return P[sized(j) * sized(n) + sized(i)]; }

  void start(std::span<const Member> those, const double* mean, const double* covariance) {
    n = static_cast<int>(those.size());
    members.assign(those.begin(), those.end());
    x.assign(mean, mean + n);
    P.assign(covariance, covariance + n * n);
  }

  void start_gain() {
    if (!with_gain) return;
    columns = n;
    G.assign(sized(n) * sized(n), 0.0);
    for (int i = 0; i < n; ++i) G[sized(i) * sized(n) + sized(i)] = 1.0;
  }

  // Undoes noise and transition: x_k = F^-1 (x_k+1 - u - Q P_pred^-1 (x_k+1 - x_pred)).
  void undo(const Recorder& records, const Recorder::Step& step, bool root) {
    unpack(records.number(step.matrix), root);
    gather_noise(records, step);
    const double* predicted = records.number(step.predicted);
    const int r = static_cast<int>(noisy_.size());
    // A = Q P_pred^-1, r rows, and Q - Q P_pred^-1 Q.
    A_.assign(sized(r) * sized(n), 0.0);
    W_.assign(sized(r) * sized(n), 0.0);
    for (int a = 0; a < r; ++a) {
      double* w = W_.data() + sized(a) * sized(n);
      w[noisy_[sized(a)]] = 1.0;
      detail::solve_lower(L_.data(), n, n, w, noisy_[sized(a)]);
      detail::solve_upper(L_.data(), n, n, w);
    }
    for (int a = 0; a < r; ++a) {
      for (int b = 0; b < r; ++b) {
        const double q = Q_[sized(a) * sized(r) + sized(b)];
        if (q == 0.0) continue;
        for (int i = 0; i < n; ++i) A_[sized(a) * sized(n) + sized(i)] += q * W_[sized(b) * sized(n) + sized(i)];
      }
    }
    // Mean.
    move_.assign(sized(r), 0.0);
    for (int a = 0; a < r; ++a) {
      for (int i = 0; i < n; ++i) move_[sized(a)] += A_[sized(a) * sized(n) + sized(i)] * (x[sized(i)] - predicted[i]);
    }
    for (int a = 0; a < r; ++a) x[sized(noisy_[sized(a)])] -= shift_[sized(a)] + move_[sized(a)];
    // Covariance: (I - E A) P (I - E A)' + E (Q - Q P_pred^-1 Q) E'.
    T_.assign(sized(r) * sized(n), 0.0);
    for (int a = 0; a < r; ++a) {
      for (int j = 0; j < n; ++j) {
        const double factor = A_[sized(a) * sized(n) + sized(j)];
        if (factor == 0.0) continue;
        const double* column = P.data() + sized(j) * sized(n);
        for (int i = 0; i < n; ++i) T_[sized(a) * sized(n) + sized(i)] += factor * column[i];
      }
    }
    corner_.assign(sized(r) * sized(r), 0.0);
    for (int a = 0; a < r; ++a) {
      for (int b = 0; b < r; ++b) {
        double sum = Q_[sized(a) * sized(r) + sized(b)];
        for (int c = 0; c < r; ++c) {
          sum -= A_[sized(a) * sized(n) + sized(noisy_[sized(c)])] * Q_[sized(c) * sized(r) + sized(b)];
        }
        for (int i = 0; i < n; ++i) sum += T_[sized(a) * sized(n) + sized(i)] * A_[sized(b) * sized(n) + sized(i)];
        corner_[sized(a) * sized(r) + sized(b)] = sum;
      }
    }
    for (int a = 0; a < r; ++a) {
      const int g = noisy_[sized(a)];
      for (int i = 0; i < n; ++i) {
        at(g, i) -= T_[sized(a) * sized(n) + sized(i)];
        at(i, g) -= T_[sized(a) * sized(n) + sized(i)];
      }
    }
    for (int a = 0; a < r; ++a) {
      for (int b = 0; b < r; ++b) {
        at(noisy_[sized(a)], noisy_[sized(b)]) +=
            0.5 * (corner_[sized(a) * sized(r) + sized(b)] + corner_[sized(b) * sized(r) + sized(a)]);
      }
    }
    if (with_gain) {  // G <- (I - E A) G, with G the identity when a step begins
      for (int a = 0; a < r; ++a) {
        for (int j = 0; j < columns; ++j) {
          G[sized(j) * sized(n) + sized(noisy_[sized(a)])] -= A_[sized(a) * sized(n) + sized(j)];
        }
      }
    }
    for (int k = 0; k < step.pair_count; ++k) {
      const auto& pair = records.pair(step.pairs)[k];
      const double dt = step.dt_s;
      x[sized(pair.to)] -= dt * x[sized(pair.from)];
      for (int j = 0; j < n; ++j) at(pair.to, j) -= dt * at(pair.from, j);
      for (int i = 0; i < n; ++i) at(i, pair.to) -= dt * at(i, pair.from);
      for (int j = 0; with_gain && j < columns; ++j) {
        G[sized(j) * sized(n) + sized(pair.to)] -= dt * G[sized(j) * sized(n) + sized(pair.from)];
      }
    }
  }

  // Drops what `those` do not have: components that joined later.
  void restrict_to(std::span<const Member> those) {
    kept_.clear();
    for (int i = 0; i < n; ++i) {
      if (place_of(those, members[sized(i)].uid) >= 0) kept_.push_back(i);
    }
    const int m = static_cast<int>(kept_.size());
    if (m == n) return;
    for (int j = 0; j < m; ++j) {
      for (int i = 0; i < m; ++i) P[sized(j) * sized(m) + sized(i)] = at(kept_[sized(i)], kept_[sized(j)]);
    }
    for (int j = 0; with_gain && j < columns; ++j) {
      for (int i = 0; i < m; ++i) G[sized(j) * sized(m) + sized(i)] = G[sized(j) * sized(n) + sized(kept_[sized(i)])];
    }
    for (int i = 0; i < m; ++i) {
      x[sized(i)] = x[sized(kept_[sized(i)])];
      members[sized(i)] = members[sized(kept_[sized(i)])];
    }
    n = m;
    x.resize(sized(m));
    members.resize(sized(m));
    P.resize(sized(m) * sized(m));
    if (with_gain) G.resize(sized(m) * sized(columns));
  }

  // Brings back components that left: what the others' future says of them through `snapshot`, the covariance before.
  void extend(std::span<const Member> those, const double* mean, const double* snapshot) {
    restrict_to(those);
    const int full = static_cast<int>(those.size());
    std::vector<int> place(sized(n)), lost;
    for (int i = 0; i < n; ++i) place[sized(i)] = place_of(those, members[sized(i)].uid);
    for (int i = 0; i < full; ++i) {
      if (std::find(place.begin(), place.end(), i) == place.end()) lost.push_back(i);
    }
    const auto old = [&](int i, int j) { return snapshot[sized(j) * sized(full) + sized(i)]; };
    std::vector<double> L(sized(n) * sized(n));
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < n; ++i) L[sized(j) * sized(n) + sized(i)] = old(place[sized(i)], place[sized(j)]);
    }
    detail::factorize_lower(L.data(), n, n, 1e-15, false);
    std::vector<double> M(sized(full) * sized(n), 0.0);  // row-major: P_XC P_CC^-1, the identity for what stayed
    for (int i = 0; i < n; ++i) M[sized(place[sized(i)]) * sized(n) + sized(i)] = 1.0;
    for (const int a : lost) {
      double* row = M.data() + sized(a) * sized(n);
      for (int i = 0; i < n; ++i) row[i] = old(a, place[sized(i)]);
      detail::solve_lower(L.data(), n, n, row);
      detail::solve_upper(L.data(), n, n, row);
    }
    std::vector<double> new_x(sized(full)), MP(sized(full) * sized(n), 0.0), new_P(sized(full) * sized(full), 0.0);
    for (int a = 0; a < full; ++a) {
      const double* row = M.data() + sized(a) * sized(n);
      double value = mean[a];
      for (int i = 0; i < n; ++i) value += row[i] * (x[sized(i)] - mean[place[sized(i)]]);
      new_x[sized(a)] = value;
      for (int j = 0; j < n; ++j) {
        for (int i = 0; i < n; ++i) MP[sized(a) * sized(n) + sized(j)] += row[i] * at(i, j);
      }
    }
    for (int a = 0; a < full; ++a) {
      for (int b = 0; b < full; ++b) {
        double sum = 0.0;
        for (int i = 0; i < n; ++i) sum += MP[sized(a) * sized(n) + sized(i)] * M[sized(b) * sized(n) + sized(i)];
        new_P[sized(b) * sized(full) + sized(a)] = sum;
      }
    }
    for (const int a : lost) {  // and what the others leave open of those that left
      for (const int b : lost) {
        double sum = old(a, b);
        for (int i = 0; i < n; ++i) sum -= M[sized(a) * sized(n) + sized(i)] * old(place[sized(i)], b);
        new_P[sized(b) * sized(full) + sized(a)] += sum;
      }
    }
    if (with_gain) {
      std::vector<double> new_G(sized(full) * sized(columns), 0.0);
      for (int j = 0; j < columns; ++j) {
        for (int a = 0; a < full; ++a) {
          double sum = 0.0;
          for (int i = 0; i < n; ++i) sum += M[sized(a) * sized(n) + sized(i)] * G[sized(j) * sized(n) + sized(i)];
          new_G[sized(j) * sized(full) + sized(a)] = sum;
        }
      }
      G = std::move(new_G);
    }
    x = std::move(new_x);
    P = std::move(new_P);
    members.assign(those.begin(), those.end());
    n = full;
  }

  void symmetrize() noexcept {
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < j; ++i) at(i, j) = at(j, i) = 0.5 * (at(i, j) + at(j, i));
    }
  }

 private:
  [[nodiscard]] static int place_of(std::span<const Member> those, int uid) noexcept {
    for (std::size_t i = 0; i < those.size(); ++i) {
      if (those[i].uid == uid) return static_cast<int>(i);
    }
    return -1;
  }

  void unpack(const double* packed, bool root) {
    L_.assign(sized(n) * sized(n), 0.0);
    for (int j = 0; j < n; ++j) {
      std::copy_n(packed, n - j, L_.data() + sized(j) * sized(n) + sized(j));
      packed += n - j;
    }
    if (!root) detail::factorize_lower(L_.data(), n, n, 1e-15, false);
  }

  int noisy_place(int place) {
    for (std::size_t i = 0; i < noisy_.size(); ++i) {
      if (noisy_[i] == place) return static_cast<int>(i);
    }
    noisy_.push_back(place);
    return static_cast<int>(noisy_.size()) - 1;
  }

  void gather_noise(const Recorder& records, const Recorder::Step& step) {
    noisy_.clear();
    const std::span pairs(records.pair(step.pairs), sized(step.pair_count));
    const std::span noises(records.noise(step.noises), sized(step.noise_count));
    for (const auto& p : pairs) {
      if (!(p.value > 0.0)) continue;
      noisy_place(p.from);
      noisy_place(p.to);
    }
    for (const auto& p : noises) noisy_place(p.place);
    const std::size_t r = noisy_.size();
    Q_.assign(r * r, 0.0);
    shift_.assign(r, 0.0);
    for (const auto& p : pairs) {
      if (!(p.value > 0.0)) continue;
      const std::size_t a = sized(noisy_place(p.from));
      const std::size_t b = sized(noisy_place(p.to));
      Q_[a * r + a] += p.rate;
      Q_[a * r + b] += p.cross;
      Q_[b * r + a] += p.cross;
      Q_[b * r + b] += p.value;
    }
    for (const auto& p : noises) {
      const std::size_t a = sized(noisy_place(p.place));
      Q_[a * r + a] += p.variance;
      shift_[a] += p.shift;
    }
  }

  std::vector<double> L_, A_, W_, T_, Q_, shift_, move_, corner_;
  std::vector<int> noisy_, kept_;
};

bool all_finite(const std::vector<double>& values) noexcept {
  return std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); });
}

}  // namespace

OpportunisticSmoother OpportunisticNavigator::smooth(bool with_gains) const {
  const Recorder& records = impl_->recorder;
  const auto steps = records.all();
  if (records.steps() == 0) throw std::invalid_argument("record: nothing was recorded; start_recording before the run");
  const bool root = impl_->options.form == OpportunisticForm::kSquareRoot;
  OpportunisticSmoother out;
  out.gains_ = with_gains;
  out.names_ = impl_->names;
  out.sources_ = impl_->owners;
  out.t_s_.resize(sized(records.steps()));
  out.epochs_.resize(sized(records.steps()));
  std::size_t numbers = 0;
  std::size_t members = 0;
  int next_n = 0;
  for (std::size_t k = steps.size(); k-- > 0;) {
    if (steps[k].leave) continue;
    const std::size_t n = sized(steps[k].n);
    numbers += n + n * n + (with_gains ? n * sized(next_n) : 0);
    members += n;
    next_n = steps[k].n;
  }
  out.numbers_.reserve(numbers);
  out.members_.reserve(members);

  // Steps that left something behind after the last epoch come with their own covariance and say nothing new.
  std::size_t k = steps.size() - 1;
  while (steps[k].leave) --k;
  const std::span<const Member> last(records.member(steps[k].members), sized(steps[k].n));
  Backward state(with_gains);
  state.start(last, records.number(steps[k].filtered), records.last());
  int epoch = records.steps() - 1;
  const auto keep = [&] {
    state.symmetrize();
    if (!all_finite(state.x) || !all_finite(state.P)) {
      throw std::runtime_error("record: a smoothed epoch is not finite at t_s = " + std::to_string(steps[k].t_s));
    }
    auto& e = out.epochs_[sized(epoch)];
    out.t_s_[sized(epoch)] = steps[k].t_s;
    e.n = state.n;
    e.mean = out.numbers_.size();
    out.numbers_.insert(out.numbers_.end(), state.x.begin(), state.x.end());
    e.covariance = out.numbers_.size();
    out.numbers_.insert(out.numbers_.end(), state.P.begin(), state.P.end());
    e.gain = out.numbers_.size();
    if (with_gains && epoch + 1 < records.steps()) {
      out.numbers_.insert(out.numbers_.end(), state.G.begin(), state.G.end());
    }
    e.members = out.members_.size();
    for (const Member& m : state.members) out.members_.push_back(m.uid);
  };
  keep();
  while (k > 0) {
    state.start_gain();
    state.undo(records, steps[k], root);
    for (--k; steps[k].leave; --k) {
      state.extend({records.member(steps[k].members), sized(steps[k].n)}, records.number(steps[k].filtered),
                   records.number(steps[k].matrix));
    }
    state.restrict_to({records.member(steps[k].members), sized(steps[k].n)});
    --epoch;
    keep();
  }
  return out;
}

int OpportunisticSmoother::place(const Epoch& epoch, int component) const noexcept {
  const auto first = members_.begin() + static_cast<std::ptrdiff_t>(epoch.members);
  const auto found = std::lower_bound(first, first + epoch.n, component);
  return found != first + epoch.n && *found == component ? static_cast<int>(found - first) : -1;
}

std::vector<double> OpportunisticSmoother::mean() const {
  std::vector<double> out(t_s_.size() * names_.size(), kNaN);
  for (std::size_t k = 0; k < epochs_.size(); ++k) {
    for (int i = 0; i < epochs_[k].n; ++i) {
      const auto column = sized(members_[epochs_[k].members + sized(i)]);
      out[k * names_.size() + column] = numbers_[epochs_[k].mean + sized(i)];
    }
  }
  return out;
}

std::vector<double> OpportunisticSmoother::sigma() const {
  std::vector<double> out(t_s_.size() * names_.size(), kNaN);
  for (std::size_t k = 0; k < epochs_.size(); ++k) {
    for (int i = 0; i < epochs_[k].n; ++i) {
      const auto column = sized(members_[epochs_[k].members + sized(i)]);
      const double variance = numbers_[epochs_[k].covariance + sized(i) * sized(epochs_[k].n + 1)];
      out[k * names_.size() + column] = std::sqrt(std::max(variance, 0.0));
    }
  }
  return out;
}

std::vector<double> OpportunisticSmoother::covariance(std::span<const int> components) const {
  for (const int c : components) {
    if (c < 0 || sized(c) >= names_.size())
      throw std::invalid_argument("components: " + std::to_string(c) + " is none");
  }
  const std::size_t m = components.size();
  std::vector<double> out(t_s_.size() * m * m, kNaN);
  for (std::size_t k = 0; k < epochs_.size(); ++k) {
    for (std::size_t a = 0; a < m; ++a) {
      for (std::size_t b = 0; b < m; ++b) {
        const int i = place(epochs_[k], components[a]);
        const int j = place(epochs_[k], components[b]);
        if (i < 0 || j < 0) continue;
        out[(k * m + a) * m + b] = numbers_[epochs_[k].covariance + sized(j) * sized(epochs_[k].n) + sized(i)];
      }
    }
  }
  return out;
}

std::vector<double> OpportunisticSmoother::lag_covariance(int component, int max_lag) const {
  if (component < 0 || sized(component) >= names_.size()) {
    throw std::invalid_argument("component = " + std::to_string(component) + " is none");
  }
  if (!gains_) throw std::invalid_argument("gains: expected; smooth with them for covariances between epochs");
  if (max_lag < 0) throw std::invalid_argument("max_lag = " + std::to_string(max_lag) + " must be >= 0");
  const std::size_t width = sized(max_lag) + 1;
  std::vector<double> out(t_s_.size() * width, kNaN);
  std::vector<double> row, next;
  for (std::size_t k = 0; k < epochs_.size(); ++k) {
    const int at = place(epochs_[k], component);
    if (at < 0) continue;
    row.assign(sized(epochs_[k].n), 0.0);
    row[sized(at)] = 1.0;
    for (std::size_t lag = 0; lag < width && k + lag < epochs_.size(); ++lag) {
      const Epoch& e = epochs_[k + lag];
      const int there = place(e, component);
      if (there < 0) break;
      double sum = 0.0;
      const double* column = numbers_.data() + e.covariance + sized(there) * sized(e.n);
      for (int i = 0; i < e.n; ++i) sum += row[sized(i)] * column[i];
      out[k * width + lag] = sum;
      if (k + lag + 1 >= epochs_.size()) break;
      const int columns = epochs_[k + lag + 1].n;
      next.assign(sized(columns), 0.0);
      for (int j = 0; j < columns; ++j) {
        const double* gain = numbers_.data() + e.gain + sized(j) * sized(e.n);
        double product = 0.0;
        for (int i = 0; i < e.n; ++i) product += row[sized(i)] * gain[i];
        next[sized(j)] = product;
      }
      row.swap(next);
    }
  }
  return out;
}

}  // namespace soopnav::navigation

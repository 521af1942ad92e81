#include "soopnav/waveform/lte/super_resolution.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <stdexcept>
#include <string>
#include <vector>

#include "waveform/lte/kernels.hpp"
#include "waveform/lte/link_tracker.hpp"
#include "waveform/lte/noise_level.hpp"
#include "waveform/lte/path_fit.hpp"
#include "waveform/lte/path_subspace.hpp"
#include "waveform/lte/subframe_reader.hpp"

namespace soopnav::lte {

namespace {
constexpr double kTwoPi = 2.0 * std::numbers::pi;
constexpr int kReference = 2048;     // samples per 1 / 15 kHz that refine_delay counts in
constexpr double kFalsePath = 1e-6;  // of a path in noise alone
constexpr double kFalsePeak = 1e-3;  // of a first peak in noise alone
constexpr double kPairCells = 2.0, kPairStep = 0.125;

void require(bool good, const char* name, double value, const char* rule) {
  if (!good) throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + "; " + rule);
}

int sign_count(std::span<const int> f) {
  int below = 0;
  while (below < static_cast<int>(f.size()) && f[static_cast<std::size_t>(below)] < 0) ++below;
  return below;
}

bool is_comb(const ChannelView& c) {
  const auto n = c.frequencies.size();
  if (n < 12 || n > static_cast<std::size_t>(PathFit::kElements) || n % 2 != 0 || c.ports < 1 || c.ports > kMaxPorts) {
    return false;
  }
  const auto half = static_cast<std::size_t>(sign_count(c.frequencies));
  const int step = c.frequencies[1] - c.frequencies[0];
  if (2 * half != n || step < 1) return false;
  for (std::size_t j = 1; j < n; ++j) {
    const int gap = c.frequencies[j] - c.frequencies[j - 1];
    if (gap != step && !(j == half && gap > 0)) return false;
  }
  return true;
}
}  // namespace

struct PathResolver::Impl {
  explicit Impl(const ResolverOptions& o) : options(o) {
    for (auto& t : turned) t.resize(PathFit::kElements);
    for (auto& r : left) r.resize(PathFit::kElements);
    frequencies.reserve(PathFit::kElements);
  }

  ResolverOptions options;
  PathFit fit;
  PathSubspace subspace;
  CoarseDelay coarse;
  ChannelView view;  // the turned channel
  std::vector<int> frequencies;
  std::array<std::vector<Cf32>, kMaxPorts> turned, left;
  double centre = 0.0;  // turns per 15 kHz, the strongest path
  int order = 1;
  bool seen = false;

  [[nodiscard]] std::array<const Cf32*, kMaxPorts> pointers(const std::array<std::vector<Cf32>, kMaxPorts>& from,
                                                            int ports) const {
    std::array<const Cf32*, kMaxPorts> out{};
    for (int p = 0; p < ports; ++p) {
      out[static_cast<std::size_t>(p)] = from[static_cast<std::size_t>(p)].data();
    }
    return out;
  }

  // Delay (turns about the centre) of the profile's element i.
  [[nodiscard]] double turns_of(int i, int step) const {
    return static_cast<double>(i) / (static_cast<double>(coarse.profile().size()) * step);
  }
  double profile_peak(const std::array<std::vector<Cf32>, kMaxPorts>& channel, double window);
  void first_peak(double noise, double window, ResolvedPaths& out);
  bool next(int k, const PathFit::Solution& before, double window, double separation, PathFit::Solution& best);
  ResolveStatus resolve(const ChannelView& channel, ResolvedPaths& out);
};

// The largest element of the profile within the window, turns about the centre.
double PathResolver::Impl::profile_peak(const std::array<std::vector<Cf32>, kMaxPorts>& channel, double window) {
  const auto y = pointers(channel, view.ports);
  const int count = static_cast<int>(view.frequencies.size());
  static_cast<void>(coarse.estimate(y.data(), view.ports, count, kReference));
  const auto& profile = coarse.profile();
  const int size = static_cast<int>(profile.size()), step = view.frequencies[1] - view.frequencies[0];
  const int reach = std::clamp(static_cast<int>(window * size * step), 1, size / 2 - 1);
  int at = 0;
  for (int i = -reach; i <= reach; ++i) {
    if (profile[static_cast<std::size_t>((i + size) % size)] > profile[static_cast<std::size_t>((at + size) % size)]) {
      at = i;
    }
  }
  return turns_of(at, step);
}

// First local maximum over the threshold, between the grid's places by a parabola (eq. 1).
void PathResolver::Impl::first_peak(double noise, double window, ResolvedPaths& out) {
  const int count = static_cast<int>(view.frequencies.size()), step = view.frequencies[1] - view.frequencies[0];
  double weight_sum = 0.0, weight_power = 0.0;
  for (int j = 0; j < count; ++j) {
    const double w = options.peak_window == PeakWindow::kRectangular ? 1.0 : 1.0 - std::cos(kTwoPi * (j + 0.5) / count);
    weight_sum += w;
    weight_power += w * w;
    for (int p = 0; p < view.ports; ++p) {
      const auto u = static_cast<std::size_t>(p);
      left[u][static_cast<std::size_t>(j)] = turned[u][static_cast<std::size_t>(j)] * static_cast<float>(w);
    }
  }
  const double top_at = profile_peak(left, window);
  const auto& profile = coarse.profile();
  const int size = static_cast<int>(profile.size());
  const auto value = [&](int i) { return static_cast<double>(profile[static_cast<std::size_t>((i + size) % size)]); };
  const int top = static_cast<int>(std::lround(top_at * size * step));
  const int reach = std::clamp(static_cast<int>(window * size * step), 1, size / 2 - 2);
  const double cells = 2.0 * window * (view.frequencies.back() - view.frequencies.front());
  const double floor = noise * weight_power * noise_level(view.ports, std::max(2.0, 2.0 * cells), kFalsePeak);
  const double least = std::max(options.peak_threshold * options.peak_threshold * value(top), floor);
  int at = top;
  for (int i = -reach; i < top; ++i) {
    if (value(i) >= least && value(i) >= value(i - 1) && value(i) > value(i + 1)) {
      at = i;
      break;
    }
  }
  const double a = value(at - 1), b = value(at), c = value(at + 1);
  const double bend = a - 2.0 * b + c;
  const double between = bend < 0.0 ? std::clamp(0.5 * (a - c) / bend, -0.5, 0.5) : 0.0;
  out.first_peak_s = (centre + (at + between) / (static_cast<double>(size) * step)) / kSubcarrierSpacingHz;
  // A lone path of that height: bound (4) of lte_time_of_arrival.md with the mean square of the frequencies.
  double square = 0.0;
  for (const int f : view.frequencies) square += static_cast<double>(f) * f;
  const double amplitude = b / (weight_sum * weight_sum);  // sum over ports of |a|^2
  out.first_peak_sigma_s =
      std::sqrt(noise / (2.0 * std::max(amplitude * square, 1e-300))) / (kTwoPi * kSubcarrierSpacingHz);
}

// The best fit of k paths over all starts.
bool PathResolver::Impl::next(int k, const PathFit::Solution& before, double window, double separation,
                              PathFit::Solution& best) {
  const double cell = 1.0 / (view.frequencies.back() - view.frequencies.front());
  bool found = false;
  PathFit::Solution trial;
  const auto consider = [&](const PathFit::Delays& start) {
    if (!fit.polish(k, start, separation, -window, window, trial)) return;
    if (!found || trial.residual < best.residual) best = trial;
    found = true;
  };
  PathFit::Delays start{};
  if (k == 2) {
    const double reach = std::min(kPairCells * cell, window);
    const auto pair = fit.best_pair(-reach, reach, kPairStep * cell);
    consider({pair[0], pair[1]});
  }
  if (subspace.delays(k, start)) {
    for (double& t : start) t -= centre;
    bool inside = true;
    for (int l = 0; l < k; ++l) {
      inside = inside && std::abs(start[static_cast<std::size_t>(l)]) <= window;
      if (l > 0) {
        inside = inside && start[static_cast<std::size_t>(l)] - start[static_cast<std::size_t>(l - 1)] > 0.05 * cell;
      }
    }
    if (inside) consider(start);
  }
  if (before.paths == k - 1) {
    fit.residual(before, left);
    start = before.theta;
    double at = profile_peak(left, window);
    for (int l = 0; l < k - 1; ++l) {  // beside a path that is there already, on the side where it lies
      const double gap = at - start[static_cast<std::size_t>(l)];
      if (std::abs(gap) < 0.2 * cell) at = start[static_cast<std::size_t>(l)] + std::copysign(0.4 * cell, gap);
    }
    start[static_cast<std::size_t>(k - 1)] = at;
    consider(start);
  }
  return found;
}

ResolveStatus PathResolver::Impl::resolve(const ChannelView& channel, ResolvedPaths& out) {
  if (!is_comb(channel)) return ResolveStatus::kTooShort;
  const int count = static_cast<int>(channel.frequencies.size()), ports = channel.ports;
  const auto n = static_cast<std::size_t>(count);
  double energy = 0.0;
  for (int p = 0; p < ports; ++p) energy += kernels::energy(channel.port[static_cast<std::size_t>(p)], n);
  if (!std::isfinite(energy) || !(energy > 1e-30)) return ResolveStatus::kNonFinite;
  if (!(channel.noise_variance >= 0.0) || !std::isfinite(channel.noise_variance)) return ResolveStatus::kNonFinite;

  // The strongest path, on the exact frequencies, becomes delay zero.
  const int step = channel.frequencies[1] - channel.frequencies[0];
  static_cast<void>(coarse.estimate(channel.port.data(), ports, count, kReference));
  const auto& profile = coarse.profile();
  const int size = static_cast<int>(profile.size());
  const auto top = static_cast<int>(std::max_element(profile.begin(), profile.end()) - profile.begin());
  const double guess = turns_of(top < size / 2 ? top : top - size, step) * kReference;
  const double cell = 1.0 / (channel.frequencies.back() - channel.frequencies.front());
  const double peak = static_cast<double>(profile[static_cast<std::size_t>(top)]) / count;
  if (channel.noise_variance > 0.0 && peak < noise_level(ports, 2.0 * count, kFalsePath) * channel.noise_variance) {
    return ResolveStatus::kLost;
  }
  DelayFit single;
  single.tau = guess;
  if (step == 3) {  // the comb refine_delay knows
    single = refine_delay(channel.port.data(), nullptr, ports, channel.frequencies.data(), count, kReference, guess);
  }
  centre = (single.converged ? single.tau : guess) / kReference;
  frequencies.assign(channel.frequencies.begin(), channel.frequencies.end());
  for (int p = 0; p < ports; ++p) {
    const auto u = static_cast<std::size_t>(p);
    const auto half = static_cast<std::size_t>(count / 2);
    kernels::phasors(centre * frequencies[0], centre * step, turned[u].data(), half);
    kernels::phasors(centre * frequencies[half], centre * step, turned[u].data() + half, half);
    kernels::multiply(channel.port[u], turned[u].data(), turned[u].data(), n);
  }
  view.port = pointers(turned, ports);
  view.ports = ports;
  view.frequencies = frequencies;
  view.noise_variance = channel.noise_variance;
  // Near zero delay the gap would hardly show: without it the channel is taken as it came.
  subspace.compute(channel, options.ignore_gap ? 0.0 : centre, options.subspace, options.ignore_gap);
  seen = true;
  fit.set(view);
  const double window = std::min(options.window_s * kSubcarrierSpacingHz, 0.45 / step);
  const double separation = options.min_separation * cell;

  ResolvedPaths result;
  result.subspace_order = subspace.order(options.max_paths);
  PathFit::Solution chosen, before, one;
  if (!fit.polish(1, {0.0}, 0.0, -window, window, one)) return ResolveStatus::kLost;
  chosen = before = one;
  const double values = static_cast<double>(count) * ports;
  const auto cost = [&](const PathFit::Solution& s) {
    const double free = s.paths * (2.0 * ports + 1.0);
    const double penalty = options.order == OrderRule::kAic ? free : 0.5 * free * std::log(2.0 * values);
    return values * std::log(std::max(s.residual / energy, 1e-11)) + penalty;
  };
  const bool fixed = options.order == OrderRule::kFixed;
  if (options.polish) {
    double least = cost(one);
    PathFit::Solution trial;
    SmallCholesky<double, kMaxResolved> definite;  // a path that has no amplitude, or lies in another, is none
    for (int k = 2; k <= options.max_paths; ++k) {
      if (!next(k, before, window, separation, trial)) break;
      before = trial;
      const double now = cost(trial);
      if ((fixed || now < least) && definite.factor(trial.information, k, 0.0)) {
        least = now;
        chosen = trial;
      } else if (k > result.subspace_order) {
        break;
      }
    }
  }
  order = options.polish ? chosen.paths : fixed ? options.max_paths : result.subspace_order;
  PathFit::Delays raw{};
  if (subspace.delays(order, raw)) {
    for (int l = 0; l < order; ++l) {
      static_cast<void>(result.subspace_delays_s.push_back(raw[static_cast<std::size_t>(l)] / kSubcarrierSpacingHz));
    }
    if (!options.polish) {
      PathFit::Delays theta = raw;
      for (double& t : theta) t -= centre;
      PathFit::Solution unpolished;
      SmallCholesky<double, kMaxResolved> definite;  // two delays in one place are one path
      if (fit.evaluate(order, theta, unpolished) && definite.factor(unpolished.information, order, 0.0)) {
        chosen = unpolished;
      }
    }
  }

  const int k = chosen.paths;
  const double freedom = std::max(1.0, values - k * (ports + 0.5));
  const double left_over = chosen.residual / freedom;
  result.fit = channel.noise_variance > 0.0 ? left_over / channel.noise_variance : 1.0;
  result.noise_variance = std::max(channel.noise_variance, left_over);
  result.snr_db =
      10.0 *
      std::log10(std::max(1e-9, (energy / values - result.noise_variance) / std::max(result.noise_variance, 1e-300)));
  SmallCholesky<double, kMaxResolved> solver;
  if (!solver.factor(chosen.information, k, 0.0)) return ResolveStatus::kLost;
  const double scale = 0.5 * result.noise_variance / (kSubcarrierSpacingHz * kSubcarrierSpacingHz);
  for (std::size_t l = 0; l < static_cast<std::size_t>(k); ++l) {
    auto& column = result.covariance_s2[l];
    column[l] = scale;
    solver.solve(column.data());
  }
  double strongest = 0.0;
  std::array<double, kMaxResolved> power{};
  for (int l = 0; l < k; ++l) {
    for (const auto& gain : chosen.gains[static_cast<std::size_t>(l)]) {
      power[static_cast<std::size_t>(l)] += std::norm(gain) / ports;
    }
    strongest = std::max(strongest, power[static_cast<std::size_t>(l)]);
  }
  for (int l = 0; l < k; ++l) {
    const auto u = static_cast<std::size_t>(l);
    ResolvedPath path;
    path.delay_s = (chosen.theta[u] + centre) / kSubcarrierSpacingHz;
    path.sigma_s = std::sqrt(std::max(result.covariance_s2[u][u], 0.0));
    path.power_db = 10.0 * std::log10(std::max(power[u] / strongest, 1e-12));
    // The channel was turned by the centre at each element's own frequency: at the carrier that is no turn.
    for (int p = 0; p < ports; ++p)
      path.gain[static_cast<std::size_t>(p)] = chosen.gains[u][static_cast<std::size_t>(p)];
    static_cast<void>(result.paths.push_back(path));
  }
  while (result.first < k - 1 && result.paths[static_cast<std::size_t>(result.first)].power_db < options.earliest_db) {
    ++result.first;
  }
  result.toa_s = result.paths[static_cast<std::size_t>(result.first)].delay_s;
  result.toa_sigma_s = result.paths[static_cast<std::size_t>(result.first)].sigma_s;
  result.single_path_s = (one.theta[0] + centre) / kSubcarrierSpacingHz;
  first_peak(result.noise_variance, window, result);
  out = result;
  return ResolveStatus::kOk;
}

PathResolver::PathResolver(const ResolverOptions& o) {
  require(o.max_paths >= 1 && o.max_paths <= kMaxResolved, "max_paths", o.max_paths, "1 ... 6 expected");
  require(o.window_s >= 1e-7 && o.window_s <= 1e-5, "window_s", o.window_s, "1e-7 ... 1e-5 expected");
  require(o.min_separation >= 0.02 && o.min_separation <= 1.0, "min_separation", o.min_separation,
          "0.02 ... 1 of a resolution cell expected");
  require(o.earliest_db <= 0.0 && o.earliest_db >= -60.0, "earliest_db", o.earliest_db, "-60 ... 0 expected");
  require(o.peak_threshold >= 0.05 && o.peak_threshold <= 1.0, "peak_threshold", o.peak_threshold,
          "0.05 ... 1 expected");
  impl_ = std::make_unique<Impl>(o);
}
PathResolver::~PathResolver() = default;
PathResolver::PathResolver(PathResolver&&) noexcept = default;
PathResolver& PathResolver::operator=(PathResolver&&) noexcept = default;

ResolveStatus PathResolver::resolve(const ChannelView& channel, ResolvedPaths& out) {
  return impl_->resolve(channel, out);
}

void PathResolver::music(std::span<const double> delays_s, int order, std::span<double> out) const noexcept {
  const int k = std::clamp(order > 0 ? order : impl_->order, 1, std::max(1, impl_->subspace.limit()));
  for (std::size_t i = 0; i < std::min(delays_s.size(), out.size()); ++i) {
    out[i] = impl_->seen ? impl_->subspace.music(delays_s[i] * kSubcarrierSpacingHz, k) : 0.0;
  }
}

double PathResolver::music_period_s() const noexcept { return impl_->subspace.period() / kSubcarrierSpacingHz; }

void PathResolver::impulse_response(std::span<const double> delays_s, std::span<double> out) const noexcept {
  const auto& f = impl_->frequencies;
  for (std::size_t i = 0; i < std::min(delays_s.size(), out.size()); ++i) {
    double power = 0.0;
    const double theta = delays_s[i] * kSubcarrierSpacingHz - impl_->centre;
    for (int p = 0; p < impl_->view.ports; ++p) {
      std::complex<double> sum = 0.0;
      const auto& y = impl_->turned[static_cast<std::size_t>(p)];
      for (std::size_t j = 0; j < f.size(); ++j) {
        sum += std::complex<double>(y[j]) * std::polar(1.0, kTwoPi * theta * f[j]);
      }
      power += std::norm(sum);
    }
    out[i] = impl_->seen ? std::sqrt(power / impl_->view.ports) / static_cast<double>(f.size()) : 0.0;
  }
}

struct SubframePathResolver::Impl {
  Impl(double rate, const Detection& cell, const ResolverOptions& o) : reader(rate, cell), resolver(o) {
    sum.resize(reader.channels().size());
  }
  SubframeReader reader;
  PathResolver resolver;
  std::vector<Cf32> sum;
  double residual_cfo_hz = 0.0, start_s = 0.0;
};

SubframePathResolver::SubframePathResolver(double sample_rate_hz, const Detection& cell,
                                           const ResolverOptions& options) {
  require_receivable(sample_rate_hz, cell);
  impl_ = std::make_unique<Impl>(sample_rate_hz, cell, options);
}
SubframePathResolver::~SubframePathResolver() = default;
SubframePathResolver::SubframePathResolver(SubframePathResolver&&) noexcept = default;
SubframePathResolver& SubframePathResolver::operator=(SubframePathResolver&&) noexcept = default;

ResolveStatus SubframePathResolver::resolve(IqSpan iq, int first, int count, double start_s, double cfo_hz,
                                            ResolvedPaths& out) {
  Impl& m = *impl_;
  if (first < 0 || count < 1 || first + count > 10 || !std::isfinite(start_s) || !std::isfinite(cfo_hz)) {
    return ResolveStatus::kTooShort;
  }
  const double rate = m.reader.rate_hz();
  int read = 0;
  double noise = 0.0, turn = 0.0;
  for (int i = 0; i < count; ++i) {
    const int last = m.reader.tracker().reference_symbol(1);
    if (!m.reader.tracker().transmitted(2 * (first + i) + 1, last)) continue;  // TDD: may be uplink
    const double start = (start_s + i * 1e-3) * rate;
    if (!m.reader.read(iq, first + i, start, cfo_hz / rate, true)) {
      return std::isfinite(m.reader.energy()) ? ResolveStatus::kTooShort : ResolveStatus::kNonFinite;
    }
    const auto now = m.reader.channels();
    Cf32 align(1.0F, 0.0F);
    if (read == 0) {
      std::copy(now.begin(), now.end(), m.sum.begin());
    } else {
      const Cf32 correlation = kernels::dot_conj(m.sum.data(), now.data(), now.size());
      const float magnitude = std::abs(correlation);
      if (magnitude > 0.0F) align = correlation / magnitude;
      for (std::size_t j = 0; j < now.size(); ++j) m.sum[j] += kernels::multiply(now[j], align);
    }
    noise += m.reader.noise_variance();
    turn += m.reader.turn_rad();
    ++read;
  }
  if (read == 0) return ResolveStatus::kTooShort;
  const float scale = 1.0F / static_cast<float>(read);
  for (Cf32& x : m.sum) x *= scale;
  m.residual_cfo_hz = turn / read / (kTwoPi * 0.5e-3);
  m.start_s = start_s;
  ChannelView view;
  for (int p = 0; p < m.reader.ports(); ++p) view.port[static_cast<std::size_t>(p)] = channel(p).data();
  view.ports = m.reader.ports();
  view.frequencies = m.reader.frequencies();
  view.noise_variance = std::max(noise / read, 1e-14 * m.reader.energy()) / (2.0 * read);
  const ResolveStatus status = m.resolver.resolve(view, out);
  if (status != ResolveStatus::kOk) return status;
  for (ResolvedPath& path : out.paths) path.delay_s += start_s;
  for (double& t : out.subspace_delays_s) t += start_s;
  out.toa_s += start_s;
  out.single_path_s += start_s;
  out.first_peak_s += start_s;
  return ResolveStatus::kOk;
}

std::span<const Cf32> SubframePathResolver::channel(int port) const noexcept {
  const auto n = static_cast<std::size_t>(impl_->reader.elements());
  if (port < 0 || port >= impl_->reader.ports()) return {};
  return std::span<const Cf32>(impl_->sum).subspan(static_cast<std::size_t>(port) * n, n);
}
std::span<const int> SubframePathResolver::frequencies() const noexcept { return impl_->reader.frequencies(); }
int SubframePathResolver::ports() const noexcept { return impl_->reader.ports(); }
const PathResolver& SubframePathResolver::resolver() const noexcept { return impl_->resolver; }
double SubframePathResolver::residual_cfo_hz() const noexcept { return impl_->residual_cfo_hz; }
double SubframePathResolver::start_s() const noexcept { return impl_->start_s; }

}  // namespace soopnav::lte

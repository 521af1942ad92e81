#include "waveform/lte/link_tracker.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "waveform/lte/kernels.hpp"

namespace soopnav::lte {

namespace {
using kernels::multiply;
using kernels::multiply_conj;

struct Line {
  double intercept = 0.0, slope = 0.0, centre = 0.0, slope_sigma = std::numeric_limits<double>::infinity(),
         intercept_sigma = 0.0;
};

// Weighted straight line y = a + b x; the slope stays 0 with one point.
Line fit_line(const std::vector<LinkTracker::FrameEstimate>& points, double LinkTracker::FrameEstimate::*value,
              double LinkTracker::FrameEstimate::*sigma) {
  double w = 0.0, wx = 0.0, wy = 0.0;
  for (const auto& p : points) {
    const double weight = 1.0 / std::max(p.*sigma * (p.*sigma), 1e-30);
    w += weight;
    wx += weight * p.time;
    wy += weight * p.*value;
  }
  Line line;
  if (!(w > 0.0)) return line;
  const double mx = wx / w, my = wy / w;
  line.centre = mx;
  double sxx = 0.0, sxy = 0.0;
  for (const auto& p : points) {
    const double weight = 1.0 / std::max(p.*sigma * (p.*sigma), 1e-30);
    sxx += weight * (p.time - mx) * (p.time - mx);
    sxy += weight * (p.time - mx) * (p.*value - my);
  }
  if (points.size() > 1 && sxx > 0.0) {
    line.slope = sxy / sxx;
    line.slope_sigma = 1.0 / std::sqrt(sxx);
  }
  line.intercept = my - line.slope * mx;
  line.intercept_sigma = 1.0 / std::sqrt(w);
  if (points.size() > 2) {  // residuals larger than the noise explains (fading, interference) widen the answer
    double chi2 = 0.0;
    for (const auto& p : points) {
      const double e = (p.*value - line.intercept - line.slope * p.time) / std::max(p.*sigma, 1e-15);
      chi2 += e * e;
    }
    const double excess = std::sqrt(std::max(1.0, chi2 / static_cast<double>(points.size() - 2)));
    line.slope_sigma *= excess;
    line.intercept_sigma *= excess;
  }
  return line;
}
}  // namespace

DelayFit refine_delay(const Cf32* const* y, const Cf32* const* reference, int ports, const int* frequencies, int count,
                      int fft_size, double start) {
  DelayFit fit;
  fit.tau = start;
  const double omega = 2.0 * std::numbers::pi / fft_size;
  // Both halves of the band step by three subcarriers; only the carrier's gap breaks the progression.
  int split = 0;
  while (split < count && frequencies[split] < 0) ++split;
  std::array<Cf32, 1024> phasor;
  const double span = static_cast<double>(frequencies[count - 1] - frequencies[0]);
  const double limit = 0.5 * fft_size / std::max(span, 1.0);  // half of a resolution cell
  for (int iteration = 0; iteration < 12; ++iteration) {
    double j0 = 0.0, j1 = 0.0, j2 = 0.0;
    const double turn = fit.tau / fft_size;
    const auto n = static_cast<std::size_t>(std::min<int>(count, static_cast<int>(phasor.size())));
    const auto s = std::min(static_cast<std::size_t>(split), n);
    if (s > 0) kernels::phasors(frequencies[0] * turn, 3.0 * turn, phasor.data(), s);
    if (s < n) kernels::phasors(frequencies[s] * turn, 3.0 * turn, phasor.data() + s, n - s);
    for (int p = 0; p < ports; ++p) {
      std::array<double, 8> s0r{}, s0i{}, s1r{}, s1i{}, s2r{}, s2i{};
      std::size_t j = 0;
      const auto one = [&](std::size_t at, std::size_t lane) {
        Cf32 c = y[p][at];
        if (reference != nullptr) c = multiply_conj(c, reference[p][at]);
        c = multiply(c, phasor[at]);
        const auto f = static_cast<double>(frequencies[at]);
        const auto re = static_cast<double>(c.real()), im = static_cast<double>(c.imag());
        s0r[lane] += re;
        s0i[lane] += im;
        s1r[lane] += f * re;
        s1i[lane] += f * im;
        s2r[lane] += f * f * re;
        s2i[lane] += f * f * im;
      };
      for (; j + 8 <= n; j += 8) {
        for (std::size_t lane = 0; lane < 8; ++lane) one(j + lane, lane);
      }
      for (std::size_t lane = 0; j < n; ++j, ++lane) one(j, lane);
      const auto total = [](const std::array<double, 8>& v) {
        return ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7]));
      };
      const double ar = total(s0r), ai = total(s0i), br = total(s1r), bi = total(s1i), cr = total(s2r), ci = total(s2i);
      j0 += ar * ar + ai * ai;
      j1 += 2.0 * omega * (ai * br - ar * bi);  // 2 Re(conj(S0) j S1)
      j2 += 2.0 * omega * omega * (br * br + bi * bi - ar * cr - ai * ci);
    }
    fit.power = j0;
    if (!(j0 > 0.0)) return fit;
    fit.curvature = -j2 / (2.0 * j0);
    double step = j2 < 0.0 ? -j1 / j2 : std::copysign(0.25 * limit, j1);
    step = std::clamp(step, -0.5 * limit, 0.5 * limit);
    fit.tau += step;
    if (std::abs(step) < 1e-7) {
      fit.converged = j2 < 0.0 && std::abs(fit.tau - start) < 4.0 * limit;
      return fit;
    }
  }
  fit.converged = fit.curvature > 0.0;
  return fit;
}

CoarseDelay::CoarseDelay() = default;

double CoarseDelay::estimate(const Cf32* const* y, int ports, int count, int fft_size) {
  int size = 64;
  while (size < 4 * count) size *= 2;
  if (size != size_) {
    size_ = size;
    plans_.clear();
    plans_.emplace_back(size, dsp::FftDirection::kInverse);
    padded_.assign(static_cast<std::size_t>(size), Cf32{});
    response_.resize(static_cast<std::size_t>(size));
    profile_.resize(static_cast<std::size_t>(size));
  }
  std::fill(profile_.begin(), profile_.end(), 0.0F);
  for (int p = 0; p < ports; ++p) {
    std::copy_n(y[p], count, padded_.begin());
    std::fill(padded_.begin() + count, padded_.end(), Cf32{});
    plans_.front().execute(padded_.data(), response_.data());
    kernels::accumulate_power(response_.data(), profile_.data(), profile_.size());
  }
  const auto top = static_cast<int>(std::max_element(profile_.begin(), profile_.end()) - profile_.begin());
  const double turns = static_cast<double>(top < size / 2 ? top : top - size) / size;  // of 1 / 45 kHz
  return turns * fft_size / 3.0;
}

const Cf32* LinkTracker::mean_channel(int port) const noexcept {
  return mean_.data() + static_cast<std::size_t>(port) * static_cast<std::size_t>(elements_);
}

void LinkTracker::align(const CrsTracker& tracker, std::size_t first, std::size_t last) {
  const auto& frames = tracker.frames();
  elements_ = tracker.elements();
  ports_ = tracker.cell().n_ports;
  const auto n = static_cast<std::size_t>(elements_);
  const auto ports = static_cast<std::size_t>(ports_);
  estimates_.resize(frames.size());
  mean_.assign(n * ports, Cf32{});
  std::array<const Cf32*, kMaxPorts> mean{};
  for (std::size_t p = 0; p < ports; ++p) mean[p] = mean_.data() + p * n;

  // A running mean, each frame turned onto it.
  double weight = 0.0;
  for (std::size_t f = first; f < last; ++f) {
    Cf32 correlation{};
    for (std::size_t p = 0; p < ports; ++p) {
      correlation += kernels::dot_conj(tracker.channel(f, static_cast<int>(p)), mean[p], n);
    }
    const float magnitude = std::abs(correlation);
    Cf32 turn = magnitude > 0.0F ? std::conj(correlation) / magnitude : Cf32(1.0F, 0.0F);
    const auto w = static_cast<float>(frames[f].symbols);
    turn *= w;
    for (std::size_t p = 0; p < ports; ++p) {
      const Cf32* x = tracker.channel(f, static_cast<int>(p));
      Cf32* m = mean_.data() + p * n;
      for (std::size_t j = 0; j < n; ++j) m[j] += multiply(x[j], turn);
    }
    weight += static_cast<double>(w);
  }
  if (!(weight > 0.0)) return;
  for (Cf32& m : mean_) m /= static_cast<float>(weight);

  // An element of a port is averaged over half of the symbols of a frame (the other half carries the other shift).
  const double noise = tracker.noise_variance();
  mean_noise_ = noise / (0.5 * weight);
  double mean_power = 0.0;
  for (std::size_t p = 0; p < ports; ++p) mean_power += kernels::energy(mean[p], n) / (elements_ * ports_);
  power_ = std::max(mean_power - mean_noise_, 1e-30);
  snr_ = noise > 0.0 ? std::max(1e-6, (mean_power - mean_noise_) / noise) : 1e12;

  double previous = 0.0;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    FrameEstimate& e = estimates_[f];
    measure(tracker, f, mean.data(), 0.0, e);
    if (f > 0) e.phase = previous + std::remainder(e.phase - previous, 1.0);
    previous = e.phase;
  }
}

void LinkTracker::measure(const CrsTracker& tracker, std::size_t frame, const Cf32* const* reference,
                          double reference_noise, FrameEstimate& out) {
  const auto n = static_cast<std::size_t>(elements_);
  const CrsTracker::Frame& f = tracker.frames()[frame];
  out.index = f.index;
  out.time = f.mean_time;
  std::array<const Cf32*, kMaxPorts> y{};
  double reference_energy = 0.0;
  Cf32 correlation{};
  for (int p = 0; p < ports_; ++p) {
    const auto u = static_cast<std::size_t>(p);
    y[u] = tracker.channel(frame, p);
    reference_energy += kernels::energy(reference[u], n);
    correlation += kernels::dot_conj(y[u], reference[u], n);
  }
  const DelayFit fit = refine_delay(y.data(), reference, ports_, tracker.element_frequencies().data(), elements_,
                                    tracker.fft_size(), 0.0);
  // Fisher information of the delay with free phase and amplitude per port, and of the common phase.
  const double noise = std::max(tracker.noise_variance() / (0.5 * f.symbols), 1e-14) + reference_noise;
  out.delay = fit.converged ? fit.tau : 0.0;
  out.delay_sigma = std::sqrt(noise / (2.0 * std::max(reference_energy * std::max(fit.curvature, 1e-12), 1e-30)));
  out.phase = static_cast<double>(std::arg(correlation)) / (2.0 * std::numbers::pi);
  out.phase_sigma = std::sqrt(noise / (2.0 * std::max(reference_energy, 1e-30))) / (2.0 * std::numbers::pi);
}

void LinkTracker::chain(const CrsTracker& tracker) {
  const auto& frames = tracker.frames();
  elements_ = tracker.elements();
  ports_ = tracker.cell().n_ports;
  estimates_.resize(frames.size());
  std::array<const Cf32*, kMaxPorts> before{};
  double delay = 0.0, phase = 0.0;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    FrameEstimate& e = estimates_[f];
    for (int p = 0; p < ports_; ++p) before[static_cast<std::size_t>(p)] = tracker.channel(f > 0 ? f - 1 : 0, p);
    measure(tracker, f, before.data(), tracker.noise_variance() / (0.5 * frames[f].symbols), e);
    delay += e.delay;
    phase += e.phase;
    e.delay = delay;
    e.phase = phase;
  }
}

bool LinkTracker::track(CrsTracker& tracker, IqSpan iq, LinkState& state, int iterations, double drift_sigma) {
  const int fft_size = tracker.fft_size();
  const double prior_drift = state.drift;
  const int nominal = tracker.cell().duplex == Duplex::kFdd ? 40 : 10;
  for (int iteration = 0; iteration < iterations; ++iteration) {
    read_state_ = state;
    tracker.read(iq, state, nominal / 2);
    if (tracker.frames().empty()) tracker.read(iq, state, 1);
    if (tracker.frames().empty()) return false;
    // A drift that is known well leaves the frames in step from the start.
    const double capture = static_cast<double>(iq.size());
    const bool following = iteration == 0 && tracker.frames().size() > 2 && drift_sigma * capture > 0.2;
    if (following) {
      chain(tracker);
    } else {
      align(tracker, 0, tracker.frames().size());
    }
    const Line delay = fit_line(estimates_, &FrameEstimate::delay, &FrameEstimate::delay_sigma);
    const Line phase = fit_line(estimates_, &FrameEstimate::phase, &FrameEstimate::phase_sigma);
    std::array<const Cf32*, kMaxPorts> mean{};
    for (int p = 0; p < ports_; ++p) {
      mean[static_cast<std::size_t>(p)] = following ? tracker.channel(0, p) : mean_channel(p);
    }
    const double start = coarse_.estimate(mean.data(), ports_, elements_, fft_size);
    const DelayFit absolute =
        refine_delay(mean.data(), nullptr, ports_, tracker.element_frequencies().data(), elements_, fft_size, start);
    const double tau = absolute.converged ? absolute.tau : start;
    // Both are of the slope about the mean time, so the intercept goes with the slope that is taken.
    const double measured = state.drift + delay.slope;
    const double w = 1.0 / (delay.slope_sigma * delay.slope_sigma), w0 = 1.0 / (drift_sigma * drift_sigma);
    const double drift = std::isfinite(w) && w + w0 > 0.0 ? (w * measured + w0 * prior_drift) / (w + w0) : prior_drift;
    const double change = drift - state.drift;
    const double intercept = delay.intercept + (delay.slope - change) * delay.centre;
    state.frame_start += following ? 0.0 : tau + intercept;
    state.drift = drift;
    state.frequency += phase.slope;
    drift_sigma_ = 1.0 / std::sqrt(w + w0);
    frequency_sigma_ = phase.slope_sigma;
    delay_sigma_ = delay.intercept_sigma;
  }
  return true;
}

}  // namespace soopnav::lte

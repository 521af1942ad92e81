#include "array/aperture_model.hpp"

#include <algorithm>
#include <cmath>

namespace soopnav::array {

namespace {

constexpr double kAmplitudeFloor = 0.05;  // of a node's rms: a start far off must not take a node out of the equations
constexpr int kMaxTries = 12;
constexpr int kNoiseSteps = 10;    // then the noise stays: a noise that follows each step may go round in circles
constexpr double kFlatRad = 1e-4;  // no step of this size is downhill any more: rounding has the last word
constexpr double kSingularPivot = 1e-10;  // of the diagonal before the nuisances are taken out

// Inverse of a symmetric positive definite 3 x 3, row by row.
bool invert3(const double* m, double* out) noexcept {
  const double a = m[4] * m[8] - m[5] * m[5], b = m[2] * m[5] - m[1] * m[8], c = m[1] * m[5] - m[2] * m[4];
  const double determinant = m[0] * a + m[1] * b + m[2] * c;
  if (!(determinant > 0.0)) return false;
  const double s = 1.0 / determinant;
  out[0] = a * s;
  out[1] = out[3] = b * s;
  out[2] = out[6] = c * s;
  out[4] = (m[0] * m[8] - m[2] * m[2]) * s;
  out[5] = out[7] = (m[1] * m[2] - m[0] * m[5]) * s;
  out[8] = (m[0] * m[4] - m[1] * m[1]) * s;
  return true;
}

}  // namespace

void ApertureModel::resize(std::size_t snapshots, std::size_t n_nodes, std::size_t n_modes) {
  n = snapshots;
  nodes = n_nodes;
  modes = n_modes;
  const std::size_t p = parameters();
  y.resize(n * nodes);
  for (auto* v : {&x0, &y0, &t, &phase_information, &path_information, &psi, &dx, &dy, &px_, &py_}) v->resize(n);
  mode_x.resize(modes * n);
  mode_y.resize(modes * n);
  for (auto* v : {&wave_number, &noise, &power, &theta, &offset, &phi, &amplitude, &cosine_, &sine_}) v->resize(nodes);
  used.resize(nodes);
  fixed.resize(p);
  z.resize(modes);
  information_.resize(p * p);
  inverse_.resize(p * p);
  for (auto* v : {&diagonal_, &gradient_, &step_}) v->resize(p);
  chain_inverse_.resize(9 * n);
  chain_cross_.resize(3 * p * n);
  chain_right_.resize(3 * n);
  chain_step_.resize(3 * n);
  kept_.resize(4 * nodes + modes + 3 * n);
  active_.reserve(p);
}

double ApertureModel::px(std::size_t k) const noexcept {
  double x = x0[k] + dx[k];
  for (std::size_t m = 0; m < modes; ++m) x += z[m] * mode_x[m * n + k];
  return x;
}

double ApertureModel::py(std::size_t k) const noexcept {
  double v = y0[k] + dy[k];
  for (std::size_t m = 0; m < modes; ++m) v += z[m] * mode_y[m * n + k];
  return v;
}

void ApertureModel::aim() noexcept {
  for (std::size_t i = 0; i < nodes; ++i) {
    cosine_[i] = std::cos(theta[i]);
    sine_[i] = std::sin(theta[i]);
  }
  for (std::size_t k = 0; k < n; ++k) {
    px_[k] = px(k);
    py_[k] = py(k);
  }
}

double ApertureModel::node_phase(std::size_t k, std::size_t i, double c, double s) const noexcept {
  return phi[i] + offset[i] * t[k] + wave_number[i] * (c * px_[k] + s * py_[k]);
}

void ApertureModel::settle() noexcept {
  aim();
  if (receiver == ReceiverPhase::kFree) {
    for (std::size_t k = 0; k < n; ++k) {
      std::complex<double> sum = 0.0;
      for (std::size_t i = 0; i < nodes; ++i) {
        if (used[i]) sum += amplitude[i] / noise[i] * y[k * nodes + i] * std::polar(1.0, -phase_of(i, k));
      }
      psi[k] = std::arg(sum);
    }
  }
  for (std::size_t i = 0; i < nodes; ++i) {
    if (!used[i]) continue;
    double sum = 0.0;
    for (std::size_t k = 0; k < n; ++k) {
      const double phase = psi[k] + phase_of(i, k);
      sum += y[k * nodes + i].real() * std::cos(phase) + y[k * nodes + i].imag() * std::sin(phase);
    }
    amplitude[i] = std::max(sum / static_cast<double>(n), kAmplitudeFloor * std::sqrt(power[i]));
  }
}

double ApertureModel::prior_cost() const noexcept {
  double cost = 0.0;
  for (const double v : z) cost += 0.5 * v * v;
  for (std::size_t k = 1; k < n; ++k) {
    if (receiver == ReceiverPhase::kRandomWalk) {
      const double d = psi[k] - psi[k - 1];
      cost += 0.5 * phase_information[k] * d * d;
    }
    if (path_error) {
      const double ex = dx[k] - dx[k - 1], ey = dy[k] - dy[k - 1];
      cost += 0.5 * path_information[k] * (ex * ex + ey * ey);
    }
  }
  return cost;
}

double ApertureModel::cost() const noexcept {
  double cost = prior_cost();
  for (std::size_t i = 0; i < nodes; ++i) {
    if (!used[i]) continue;
    double sum = 0.0;
    for (std::size_t k = 0; k < n; ++k) {
      sum += std::norm(y[k * nodes + i] - std::polar(amplitude[i], psi[k] + phase_of(i, k)));
    }
    cost += sum / noise[i];
  }
  return cost;
}

int ApertureModel::unknowns() const noexcept {
  int count = receiver == ReceiverPhase::kFree ? static_cast<int>(n) : receiver == ReceiverPhase::kRandomWalk ? 1 : 0;
  if (path_free) count += 2 * static_cast<int>(n);
  for (std::size_t i = 0; i < nodes; ++i) {
    if (!used[i]) continue;
    ++count;  // amplitude
    for (std::size_t j = 0; j < kPerNode; ++j) count += fixed[kPerNode * i + j] ? 0 : 1;
  }
  return count;
}

// Each prior is one equation and one unknown: what is left of the degrees of freedom belongs to the residuals.
void ApertureModel::estimate_noise() noexcept {
  double sum = 0.0;
  int data = 0;
  for (std::size_t i = 0; i < nodes; ++i) {
    if (!used[i]) continue;
    data += 2 * static_cast<int>(n);
    for (std::size_t k = 0; k < n; ++k) {
      sum += std::norm(y[k * nodes + i] - std::polar(amplitude[i], psi[k] + phase_of(i, k)));
    }
  }
  const double freedom = std::max(1.0, data - unknowns() - 2.0 * prior_cost());
  double floor = 0.0;
  for (std::size_t i = 0; i < nodes; ++i) floor = std::max(floor, used[i] ? 1e-14 * power[i] : 0.0);
  std::fill(noise.begin(), noise.end(), std::max(2.0 * sum / freedom, floor));
}

// Eq. 4 and 5: per snapshot the equations of c = [psi, dx, dy], eliminated as soon as the next one knows of them.
void ApertureModel::assemble(double damping) noexcept {
  const std::size_t p = parameters();
  std::fill(information_.begin(), information_.end(), 0.0);
  std::fill(diagonal_.begin(), diagonal_.end(), 0.0);
  std::fill(gradient_.begin(), gradient_.end(), 0.0);
  const bool phase_active = receiver != ReceiverPhase::kKnown, path_active = path_error || path_free;
  const std::size_t first_mode = kPerNode * nodes;
  for (std::size_t m = 0; m < modes; ++m) {
    const std::size_t a = first_mode + m;
    information_[a * p + a] += 1.0;
    diagonal_[a] += 1.0;
    gradient_[a] -= z[m];
  }
  for (std::size_t k = 0; k < n; ++k) {
    const bool path_here = path_active && (path_free || k > 0);
    double* const cross = &chain_cross_[3 * p * k];
    double* const right = &chain_right_[3 * k];
    double lambda[9] = {phase_active ? 0.0 : 1.0, 0.0, 0.0, 0.0, path_here ? 0.0 : 1.0, 0.0, 0.0, 0.0,
                        path_here ? 0.0 : 1.0};
    std::fill(cross, cross + 3 * p, 0.0);
    std::fill(right, right + 3, 0.0);
    for (std::size_t i = 0; i < nodes; ++i) {
      if (!used[i]) continue;
      const double weight = 2.0 * amplitude[i] * amplitude[i] / noise[i];
      const double phase = psi[k] + phase_of(i, k);
      const std::complex<double>& v = y[k * nodes + i];
      const double e = (v.imag() * std::cos(phase) - v.real() * std::sin(phase)) / amplitude[i];
      const double kx = wave_number[i] * cosine_[i], ky = wave_number[i] * sine_[i];
      const double h[3] = {phase_active ? 1.0 : 0.0, path_here ? kx : 0.0, path_here ? ky : 0.0};
      const double j[kPerNode] = {kx * py_[k] - ky * px_[k], t[k], 1.0};
      const std::size_t at = kPerNode * i;
      for (std::size_t a = 0; a < kPerNode; ++a) {
        gradient_[at + a] += weight * e * j[a];
        for (std::size_t b = 0; b < kPerNode; ++b) information_[(at + a) * p + at + b] += weight * j[a] * j[b];
        diagonal_[at + a] += weight * j[a] * j[a];
        for (std::size_t r = 0; r < 3; ++r) cross[r * p + at + a] += weight * h[r] * j[a];
      }
      for (std::size_t m = 0; m < modes; ++m) {
        const std::size_t a = first_mode + m;
        const double jm = kx * mode_x[m * n + k] + ky * mode_y[m * n + k];
        gradient_[a] += weight * e * jm;
        diagonal_[a] += weight * jm * jm;
        for (std::size_t b = 0; b < kPerNode; ++b) {
          information_[a * p + at + b] += weight * jm * j[b];
          information_[(at + b) * p + a] += weight * jm * j[b];
        }
        for (std::size_t q = 0; q < modes; ++q) {
          information_[a * p + first_mode + q] += weight * jm * (kx * mode_x[q * n + k] + ky * mode_y[q * n + k]);
        }
        for (std::size_t r = 0; r < 3; ++r) cross[r * p + a] += weight * h[r] * jm;
      }
      for (std::size_t r = 0; r < 3; ++r) {
        right[r] += weight * e * h[r];
        for (std::size_t s = 0; s < 3; ++s) lambda[3 * r + s] += weight * h[r] * h[s];
      }
    }
    const bool walk = receiver == ReceiverPhase::kRandomWalk;
    const double before[3] = {walk && k > 0 ? phase_information[k] : 0.0,
                              path_error && k > 0 ? path_information[k] : 0.0,
                              path_error && k > 0 ? path_information[k] : 0.0};
    const double after[3] = {walk && k + 1 < n ? phase_information[k + 1] : 0.0,
                             path_error && path_here && k + 1 < n ? path_information[k + 1] : 0.0,
                             path_error && path_here && k + 1 < n ? path_information[k + 1] : 0.0};
    const std::vector<double>* const state[3] = {&psi, &dx, &dy};
    for (std::size_t r = 0; r < 3; ++r) {
      lambda[3 * r + r] += before[r] + after[r];
      if (before[r] > 0.0) right[r] -= before[r] * ((*state[r])[k] - (*state[r])[k - 1]);
      if (after[r] > 0.0) right[r] += after[r] * ((*state[r])[k + 1] - (*state[r])[k]);
    }
    if (k > 0 && (before[0] > 0.0 || before[1] > 0.0)) {
      const double* const last = &chain_inverse_[9 * (k - 1)];
      const double* const last_cross = &chain_cross_[3 * p * (k - 1)];
      const double* const last_right = &chain_right_[3 * (k - 1)];
      // The path's error is 0 at the first snapshot: nothing couples to it.
      const double couple[3] = {before[0], k > 1 ? before[1] : 0.0, k > 1 ? before[2] : 0.0};
      for (std::size_t r = 0; r < 3; ++r) {
        for (std::size_t s = 0; s < 3; ++s) {
          lambda[3 * r + s] -= couple[r] * last[3 * r + s] * couple[s];
          const double gain = couple[r] * last[3 * r + s];
          if (gain == 0.0) continue;
          right[r] += gain * last_right[s];
          for (std::size_t a = 0; a < p; ++a) cross[r * p + a] += gain * last_cross[s * p + a];
        }
      }
    }
    double* const inverse = &chain_inverse_[9 * k];
    if (!invert3(lambda, inverse)) std::fill(inverse, inverse + 9, 0.0);
    for (std::size_t r = 0; r < 3; ++r) {
      for (std::size_t s = 0; s < 3; ++s) {
        const double v = inverse[3 * r + s];
        if (v == 0.0) continue;
        for (std::size_t a = 0; a < p; ++a) {
          const double left = v * cross[r * p + a];
          if (left == 0.0) continue;
          gradient_[a] -= left * right[s];
          for (std::size_t b = 0; b < p; ++b) information_[a * p + b] -= left * cross[s * p + b];
        }
      }
    }
  }
  active_.clear();
  for (std::size_t a = 0; a < p; ++a) {
    const bool node = a < first_mode;
    if (fixed[a] || (node && !used[a / kPerNode])) continue;
    active_.push_back(a);
    information_[a * p + a] += damping * diagonal_[a];
  }
}

// Cholesky factor of the active part, into the lower triangle of inverse_ (packed by the active order).
bool ApertureModel::factor(double floor) noexcept {
  const std::size_t p = parameters(), m = active_.size();
  for (std::size_t a = 0; a < m; ++a) {
    for (std::size_t b = 0; b <= a; ++b) {
      double sum = information_[active_[a] * p + active_[b]];
      for (std::size_t c = 0; c < b; ++c) sum -= inverse_[a * p + c] * inverse_[b * p + c];
      if (a == b) {
        if (!(sum > floor * diagonal_[active_[a]]) || !(sum > 0.0)) return false;
        inverse_[a * p + a] = std::sqrt(sum);
      } else {
        inverse_[a * p + b] = sum / inverse_[b * p + b];
      }
    }
  }
  return true;
}

void ApertureModel::back_substitute() noexcept {
  const std::size_t p = parameters(), m = active_.size();
  std::fill(step_.begin(), step_.end(), 0.0);
  for (std::size_t a = 0; a < m; ++a) {
    double sum = gradient_[active_[a]];
    for (std::size_t c = 0; c < a; ++c) sum -= inverse_[a * p + c] * step_[active_[c]];
    step_[active_[a]] = sum / inverse_[a * p + a];
  }
  for (std::size_t a = m; a-- > 0;) {
    double sum = step_[active_[a]];
    for (std::size_t c = a + 1; c < m; ++c) sum -= inverse_[c * p + a] * step_[active_[c]];
    step_[active_[a]] = sum / inverse_[a * p + a];
  }
  for (std::size_t k = n; k-- > 0;) {
    double right[3];
    for (std::size_t r = 0; r < 3; ++r) {
      right[r] = chain_right_[3 * k + r];
      for (std::size_t a = 0; a < p; ++a) right[r] -= chain_cross_[(3 * k + r) * p + a] * step_[a];
    }
    if (k + 1 < n) {
      if (receiver == ReceiverPhase::kRandomWalk) right[0] += phase_information[k + 1] * chain_step_[3 * (k + 1)];
      if (path_error && k > 0) {
        right[1] += path_information[k + 1] * chain_step_[3 * (k + 1) + 1];
        right[2] += path_information[k + 1] * chain_step_[3 * (k + 1) + 2];
      }
    }
    const double* const inverse = &chain_inverse_[9 * k];
    for (std::size_t r = 0; r < 3; ++r) {
      chain_step_[3 * k + r] =
          inverse[3 * r] * right[0] + inverse[3 * r + 1] * right[1] + inverse[3 * r + 2] * right[2];
    }
  }
}

void ApertureModel::keep() noexcept {
  double* at = kept_.data();
  for (const auto* v : {&theta, &offset, &phi, &amplitude, &z, &psi, &dx, &dy})
    at = std::copy(v->begin(), v->end(), at);
}

void ApertureModel::restore() noexcept {
  const double* at = kept_.data();
  for (auto* v : {&theta, &offset, &phi, &amplitude, &z, &psi, &dx, &dy}) {
    std::copy(at, at + v->size(), v->begin());
    at += v->size();
  }
}

void ApertureModel::move(double scale) noexcept {
  for (std::size_t i = 0; i < nodes; ++i) {
    theta[i] += scale * step_[kPerNode * i + kBearing];
    offset[i] += scale * step_[kPerNode * i + kOffset];
    phi[i] += scale * step_[kPerNode * i + kPhase];
  }
  for (std::size_t m = 0; m < modes; ++m) z[m] += scale * step_[kPerNode * nodes + m];
  const bool path = path_error || path_free;
  for (std::size_t k = 0; k < n; ++k) {
    if (receiver != ReceiverPhase::kKnown) psi[k] += scale * chain_step_[3 * k];
    if (path) {
      dx[k] += scale * chain_step_[3 * k + 1];
      dy[k] += scale * chain_step_[3 * k + 2];
    }
  }
}

bool ApertureModel::solve(int max_steps, double settled_rad, bool own_noise, int& steps) noexcept {
  double damping = 1e-3;
  settle();
  if (own_noise) estimate_noise();
  double last = cost();
  for (int step = 0; step < max_steps; ++step) {
    ++steps;
    keep();
    double largest = 0.0;
    bool better = false;
    for (int attempt = 0; attempt < kMaxTries; ++attempt) {
      assemble(damping);
      if (factor(0.0)) {
        back_substitute();
        largest = 0.0;
        for (std::size_t i = 0; i < nodes; ++i) {
          largest = std::max(largest, used[i] ? std::abs(step_[kPerNode * i]) : 0.0);
        }
        const double scale = largest > 0.5 ? 0.5 / largest : 1.0;
        move(scale);
        settle();
        const double now = cost();
        if (now <= last + 1e-9 * (1.0 + std::abs(last))) {
          better = true;
          last = now;
          break;
        }
        restore();
        aim();
      }
      damping = std::max(10.0 * damping, 1e-4);
    }
    if (!better) return largest < kFlatRad;
    damping = damping < 1e-9 ? 0.0 : 0.03 * damping;
    if (own_noise && step < kNoiseSteps) {
      estimate_noise();
      last = cost();
    }
    if (largest < settled_rad) return true;
  }
  return false;
}

bool ApertureModel::invert() noexcept {
  const std::size_t p = parameters();
  aim();
  assemble(0.0);
  if (!factor(kSingularPivot)) return false;
  // Columns of the inverse, one unit vector after the other; information_ is free to hold them.
  const std::size_t m = active_.size();
  std::fill(information_.begin(), information_.end(), 0.0);
  for (std::size_t column = 0; column < m; ++column) {
    std::fill(step_.begin(), step_.end(), 0.0);
    for (std::size_t a = 0; a < m; ++a) {
      double sum = a == column ? 1.0 : 0.0;
      for (std::size_t c = 0; c < a; ++c) sum -= inverse_[a * p + c] * step_[c];
      step_[a] = sum / inverse_[a * p + a];
    }
    for (std::size_t a = m; a-- > 0;) {
      double sum = step_[a];
      for (std::size_t c = a + 1; c < m; ++c) sum -= inverse_[c * p + a] * step_[c];
      step_[a] = sum / inverse_[a * p + a];
    }
    for (std::size_t a = 0; a < m; ++a) information_[active_[a] * p + active_[column]] = step_[a];
  }
  inverse_.swap(information_);
  return true;
}

}  // namespace soopnav::array

#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <span>
#include <string>

#include "particle_steps.hpp"
#include "soopnav/core/packet_math.hpp"
#include "soopnav/estimation/particle_loop.hpp"
#include "soopnav/estimation/particle_view.hpp"

/// The bodies of `MoveStep`, for the sources that instantiate it.
namespace soopnav::python {

namespace move_detail {

inline constexpr std::size_t kChunk = soopnav::detail::kParticleChunk;

// Columns of the roles of a small state among those of a larger one.
template <class Frame, class... Roles>
constexpr auto columns_of(const RoleMap& roles, ComposedState<Frame, Roles...>) {
  std::array<std::size_t, static_cast<std::size_t>(ComposedState<Frame, Roles...>::kSize)> columns{};
  std::size_t k = 0;
  const auto append = [&]<class R>(R role) {
    for (int i = 0; i < R::kDim; ++i) columns[k++] = static_cast<std::size_t>(roles.find(role) + i);
  };
  (append(Roles{}), ...);
  return columns;
}

// One motion on the columns it reads and writes.
template <class Motion, class State, class T>
struct MotionBody {
  const Motion& motion;
  const InputOf<Motion>& input;
  double dt_s;
  std::array<std::size_t, static_cast<std::size_t>(State::kSize)> columns;
  const T* const* before;
  T* const* after;
  const float* normals;
  std::size_t n;

  void operator()(std::size_t /*piece*/) const {
    using P = Packet<T>;
    soopnav::detail::ParticleColumns<T, State::kSize> from;
    std::array<T*, static_cast<std::size_t>(State::kSize)> to;
    for (std::size_t c = 0; c < columns.size(); ++c) {
      from.component[c] = before[columns[c]];
      to[c] = after[columns[c]];
    }
    for (std::size_t at = 0; at < n; at += P::kWidth) {
      ParticleView<State, T> x;
      from.load(at, x);
      ParticleNext<State, T> y{x};
      const soopnav::detail::ParticleNoise<T> w{normals + at, kChunk};
      static_cast<void>(soopnav::detail::propagate(motion, x, input, dt_s, w, y));
      for (std::size_t c = 0; c < to.size(); ++c) y.state.values[c].store(to[c] + at);
    }
  }
};

template <class Motion, class State, class T>
void run_motion(const void* motion, const double* input, double dt_s, const RoleMap& roles, const T* const* before,
                T* const* after, const float* normals, std::size_t n, bool wide) {
  const InputOf<Motion> driven = input_of<Motion>(input);
  const MotionBody<Motion, State, T> body{
      *static_cast<const Motion*>(motion), driven, dt_s, columns_of(roles, State{}), before, after, normals, n};
  soopnav::detail::CompiledLoop<MotionBody<Motion, State, T>>{body, wide}(0);
}

using ClockState = ComposedState<PlanarFrame, ClockBiasRole, ClockDriftRole>;

// What no motion is needed for: diffusion or a copy, column by column.
template <class T>
struct DiffuseBody {
  std::size_t columns;
  const T* sigma;
  const bool* moved;
  const T* const* before;
  T* const* after;
  const float* normals;
  std::size_t n;

  void operator()(std::size_t /*piece*/) const {
    using P = Packet<T>;
    for (std::size_t c = 0; c < columns; ++c) {
      const T* from = moved[c] ? after[c] : before[c];
      T* to = after[c];
      if (sigma[c] > T{0}) {
        const P s(sigma[c]);
        const float* w = normals + c * kChunk;
        for (std::size_t at = 0; at < n; at += P::kWidth) {
          (P::load(from + at) + s * P::load_float(w + at)).store(to + at);
        }
      } else if (!moved[c]) {
        std::copy_n(from, n, to);
      }
    }
  }
};

// Headings wrapped; particles with a number that is not finite stay where they were and lose their weight.
template <class T>
struct SettleBody {
  std::size_t columns;
  int heading;
  const T* const* before;
  T* const* after;
  T* log_likelihood;
  std::size_t n;
  bool& sound;

  void operator()(std::size_t /*piece*/) const {
    using P = Packet<T>;
    bool all_sound = true;
    if (heading >= 0) {
      T* psi = after[heading];
      for (std::size_t at = 0; at < n; at += P::kWidth) wrap_to_pi(P::load(psi + at)).store(psi + at);
    }
    for (std::size_t at = 0; at < n; at += P::kWidth) {
      const P start = P::load(after[0] + at);
      P zero = start - start;
      for (std::size_t c = 1; c < columns; ++c) {
        const P x = P::load(after[c] + at);
        zero += x - x;
      }
      P l(T{0});
      const auto keep = zero == P(T{0});
      if (any(!keep)) {
        all_sound = false;
        for (std::size_t c = 0; c < columns; ++c) {
          select(keep, P::load(after[c] + at), P::load(before[c] + at)).store(after[c] + at);
        }
        l = select(keep, l, P(-std::numeric_limits<T>::infinity()));
      }
      l.store(log_likelihood + at);
    }
    sound = all_sound;
  }
};

}  // namespace move_detail

template <class T>
void MoveStep<T>::prepare(const AnyProcess& process, std::span<const double> diffusion, const RoleMap& roles,
                          std::string_view state, const double* input, double dt_s, bool wide) {
  using namespace move_detail;
  roles_ = roles;
  columns_ = diffusion.size();
  wide_ = wide;
  dt_s_ = dt_s;
  input_ = input;
  next_ = nullptr;
  motion_ = nullptr;
  kernel_ = nullptr;
  motion_normals_ = 0;
  moved_.fill(false);

  const bool has_clock = roles.clock_bias >= 0 && roles.clock_drift >= 0;
  if (process.motion() != MotionKind::kRandomWalk || process.clock()) process.check_clock(has_clock, state);
  const auto use = [&]<class Motion, class State>(Motion& slot, const Motion& motion, std::type_identity<State>) {
    slot = motion;
    motion_ = &slot;
    kernel_ = &run_motion<Motion, State, T>;
    motion_normals_ = Motion::kNoise;
    for (const std::size_t c : columns_of(roles, State{})) moved_[c] = true;
  };
  const auto need = [&](bool there, std::string_view what) {
    if (!there) process.refuse_state(state, what);
  };
  switch (process.motion()) {
    case MotionKind::kRandomWalk:
      break;
    case MotionKind::kNearlyConstantVelocity:
    case MotionKind::kPiecewiseConstantAcceleration: {
      need(roles.position_dim > 0 && roles.velocity_dim == roles.position_dim, "a velocity");
      const bool velocity = process.motion() == MotionKind::kNearlyConstantVelocity;
      const auto choose = [&]<int Dim>(NearlyConstantVelocity<Dim>& a, PiecewiseConstantAcceleration<Dim>& b) {
        const std::type_identity<PositionVelocityState<Dim>> moved;
        if (velocity) {
          use(a, NearlyConstantVelocity<Dim>{.acceleration_psd = process.per_axis<Dim>()}, moved);
        } else {
          use(b, PiecewiseConstantAcceleration<Dim>{.acceleration_sigma_mps2 = process.per_axis<Dim>()}, moved);
        }
      };
      if (roles.position_dim == 1) choose(motions_.velocity1, motions_.acceleration1);
      if (roles.position_dim == 2) choose(motions_.velocity2, motions_.acceleration2);
      if (roles.position_dim == 3) choose(motions_.velocity3, motions_.acceleration3);
      break;
    }
    case MotionKind::kCoordinatedTurn:
      need(roles.turn_rate >= 0, "a turn rate");
      use(motions_.turn, process.coordinated_turn(), std::type_identity<CoordinatedTurnState>{});
      break;
    case MotionKind::kPlanarMechanization:
      need(roles.heading >= 0 && roles.velocity_dim == 2, "a heading and a velocity");
      use(motions_.inertial, process.planar_mechanization(), std::type_identity<PlanarInertialState>{});
      break;
    case MotionKind::kPlanarOdometry:
      need(roles.heading >= 0, "a heading");
      use(motions_.odometry, process.planar_odometry(), std::type_identity<Pose2>{});
      break;
  }
  clock_ = has_clock && process.clock();
  if (clock_) {
    motions_.clock = clock::TwoState<>{*process.clock()};
    for (const std::size_t c : columns_of(roles, ClockState{})) moved_[c] = true;
  }
  first_diffusion_ = motion_normals_ + (has_clock ? 2 : 0);
  const double root = std::sqrt(dt_s);
  for (std::size_t c = 0; c < columns_; ++c) sigma_[c] = static_cast<T>(diffusion[c] * root);
  if (exact_clock_) {
    for (const int c : {roles.clock_bias, roles.clock_drift}) {
      if (c >= 0) sigma_[static_cast<std::size_t>(c)] = T{0};
    }
  }
}

template <class T>
void MoveStep<T>::prepare(const double* next, std::size_t count, std::size_t columns, const RoleMap& roles, bool wide) {
  roles_ = roles;
  columns_ = columns;
  wide_ = wide;
  next_ = next;
  count_ = count;
}

template <class T>
bool MoveStep<T>::move(const T* const* before, T* const* after, T* log_likelihood, std::size_t n, std::size_t first,
                       const RandomStream& noise, std::uint64_t stride, bool noisy) const {
  using namespace move_detail;
  if (next_ != nullptr) {
    for (std::size_t i = 0; i < n; ++i) {
      const double* row = next_ + std::min(first + i, count_ - 1) * columns_;
      for (std::size_t c = 0; c < columns_; ++c) after[c][i] = static_cast<T>(row[c]);
    }
  } else {
    std::array<float, kMaxNormals * kChunk> normals;
    const auto fill = [&](std::size_t k, bool drawn) {
      if (!drawn) {
        std::fill_n(normals.begin() + static_cast<std::ptrdiff_t>(k * kChunk), n, 0.0F);
        return;
      }
      RandomStream draws = noise;
      draws.seek(k * stride + first);
      draws.fill_normal(std::span(normals).subspan(k * kChunk, n));
    };
    for (std::size_t k = 0; k < motion_normals_; ++k) fill(k, noisy);
    if (kernel_ != nullptr) {
      kernel_(motion_, input_, dt_s_, roles_, before, after, normals.data(), n, wide_);
    }
    if (clock_) {
      fill(motion_normals_, noisy && !exact_clock_);
      fill(motion_normals_ + 1, noisy && !exact_clock_);
      run_motion<clock::TwoState<>, ClockState, T>(&motions_.clock, nullptr, dt_s_, roles_, before, after,
                                                   normals.data() + motion_normals_ * kChunk, n, wide_);
    }
    for (std::size_t c = 0; c < columns_; ++c) {
      if (sigma_[c] > T{0}) fill(first_diffusion_ + c, noisy);
    }
    const DiffuseBody<T> diffuse{
        columns_, sigma_.data(), moved_.data(), before, after, normals.data() + first_diffusion_ * kChunk, n};
    soopnav::detail::CompiledLoop<DiffuseBody<T>>{diffuse, wide_}(0);
  }
  bool sound = true;
  const SettleBody<T> settle{columns_, roles_.heading, before, after, log_likelihood, n, sound};
  soopnav::detail::CompiledLoop<SettleBody<T>>{settle, wide_}(0);
  return sound;
}

}  // namespace soopnav::python

#pragma once

#include <concepts>
#include <type_traits>

namespace soopnav {

namespace detail {

struct NoInput {};

template <class Process>
struct ProcessInput {
  using Type = NoInput;
};
template <class Process>
requires requires { typename Process::Input; }
struct ProcessInput<Process> {
  using Type = typename Process::Input;
};

}  // namespace detail

/// What a process model is driven with (`Process::Input`: an IMU sample), `detail::NoInput` when by nothing.
template <class Process>
using InputOf = typename detail::ProcessInput<Process>::Type;

namespace detail {

template <class Process>
inline constexpr bool kDriven = !std::same_as<InputOf<Process>, NoInput>;

// Calls `propagate` with or without the input it declares.
template <class Process, class X, class U, class W, class Y>
[[nodiscard]] bool propagate(const Process& process, const X& x, const U& u, double dt_s, const W& w, Y& y) {
  if constexpr (kDriven<Process>) {
    return process.propagate(x, u, dt_s, w, y);
  } else {
    return process.propagate(x, dt_s, w, y);
  }
}

}  // namespace detail

/// Two process models as one: a motion and a clock, say. Longer chains nest: `JointProcess{motion, JointProcess{a,
/// b}}`.
///
/// The parts run one after the other on the same present state; a part that adds to `next` (a diffusion) adds to what
/// the one before it wrote. Transition blocks of the parts should lie on different roles. Their noises are independent:
/// the first part consumes the first `First::kNoise` standard normals, the second the rest. At most one part has an
/// input, and it becomes the pair's.
template <class First, class Second>
struct JointProcess {
  static constexpr int kNoise = First::kNoise + Second::kNoise;
  First first;
  Second second;

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    return propagate(x, detail::NoInput{}, dt_s, w, y);
  }
  template <class X, class U, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, const U& u, double dt_s, const W& w, Y& y) const {
    static_assert(!(detail::kDriven<First> && detail::kDriven<Second>), "at most one part has an input");
    Part<0, First::kNoise, Y> a{y};
    Part<First::kNoise, Second::kNoise, Y> b{y};
    return detail::propagate(first, x, u, dt_s, w, a) && detail::propagate(second, x, u, dt_s, Shifted<W>{w}, b);
  }

 private:
  template <class W>
  struct Shifted {
    const W& w;
    [[nodiscard]] decltype(auto) operator[](int i) const { return w[i + First::kNoise]; }
  };
  // The writer as one part sees it: its own columns of the noise gain.
  template <int Offset, int Count, class Y>
  struct Part {
    static constexpr bool kJacobian = Y::kJacobian;
    Y& y;
    template <class R>
    [[nodiscard]] decltype(auto) next(const R& role) {
      return y.next(role);
    }
    template <class To, class From>
    [[nodiscard]] auto transition(const To& to, const From& from) {
      return y.transition(to, from);
    }
    template <int Skip = 0, int Columns = Count, class R>
    [[nodiscard]] auto noise(const R& role) {
      return y.template noise<Offset + Skip, Columns>(role);
    }
    template <int Skip = 0, int Columns = Count>
    void scale_noise(double factor) {
      y.template scale_noise<Offset + Skip, Columns>(factor);
    }
  };
};

template <class First, class Second>
JointProcess(First, Second) -> JointProcess<First, Second>;

namespace detail {

template <class First, class Second>
struct ProcessInput<JointProcess<First, Second>> {
  using Type = std::conditional_t<kDriven<First>, InputOf<First>, InputOf<Second>>;
};

}  // namespace detail
}  // namespace soopnav

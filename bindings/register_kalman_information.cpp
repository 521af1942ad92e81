#include "kalman_filter.hpp"
#include "soopnav/estimation/information_filter.hpp"

namespace soopnav::python {

namespace {

struct Information {
  template <int N>
  using Filter = InformationFilter<ErasedState<N>>;
  static constexpr bool kSigmaPoints = false;
  static constexpr double kPadding = 1.0;
  static constexpr bool kSmallToo = false;
  template <int N>
  static constexpr bool kFewRows = false;

  template <int N, class Square>
  static Filter<N> make(const ErasedState<N>& x, const Square& P, const KalmanSetup& setup) {
    return setup.information ? Filter<N>::from_information(x, P) : Filter<N>(x, P);
  }
  template <class AnyFilter>
  static auto matrix(const AnyFilter& filter) {
    return filter.information();
  }
  template <class AnyFilter, class State, class Square>
  static void restore(AnyFilter& filter, const State& x, const Square& information) {
    filter.restore_information(x, information);
  }
};

}  // namespace

std::unique_ptr<KalmanFilter> make_information(const KalmanSetup& setup) { return make_kalman<Information>(setup); }

}  // namespace soopnav::python

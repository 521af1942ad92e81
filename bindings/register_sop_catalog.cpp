#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <stdexcept>
#include <string>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/navigation/sop_fusion.hpp"

namespace soopnav::python {

namespace {

using navigation::SopEstimate;
using navigation::SopFusionStatus;

template <int N>
py::tuple sop_tuple(const SopEstimate<N>& e) {
  std::vector<double> value(e.value.data(), e.value.data() + N);
  std::vector<double> covariance(e.covariance.data(), e.covariance.data() + N * N);  // symmetric
  return py::make_tuple(to_array(std::move(value)), to_array(std::move(covariance), {N, N}));
}

/// Rows of numbers as estimates; `at` one time for each.
template <int N>
std::vector<SopEstimate<N>> sop_estimates(const RealArrayBase& at, const NumbersBase& value,
                                          const NumbersBase& covariance, const std::vector<bool>& independent) {
  const std::size_t n = at.size();
  if (value.span().size() != n * N || covariance.span().size() != n * N * N || independent.size() != n) {
    throw std::invalid_argument("value, covariance, independent: " + std::to_string(n) + " of each expected, of " +
                                std::to_string(N) + " numbers");
  }
  std::vector<SopEstimate<N>> out(n);
  for (std::size_t i = 0; i < n; ++i) {
    out[i].t_s = at[i];
    for (int k = 0; k < N; ++k) out[i].value[k] = value.span()[i * N + static_cast<std::size_t>(k)];
    for (int k = 0; k < N * N; ++k)
      out[i].covariance.data()[k] = covariance.span()[i * N * N + static_cast<std::size_t>(k)];
    out[i].independent = independent[i];
  }
  return out;
}

py::object sop_result(SopFusionStatus status, const py::tuple& found) {
  switch (status) {
    case SopFusionStatus::kOk:
      return found;
    case SopFusionStatus::kEmpty:
      throw std::invalid_argument("value: at least one estimate expected");
    case SopFusionStatus::kUnordered:
      throw std::invalid_argument("t_s: times that do not fall expected");
    case SopFusionStatus::kUndefined:
      break;
  }
  throw std::invalid_argument("value, covariance: finite numbers and positive semi-definite matrices expected");
}

template <int N>
py::object sop_fuse_constants(const RealArrayBase& t_s, const NumbersBase& value, const NumbersBase& covariance,
                              const std::vector<bool>& independent, double variance_per_s, double at_s) {
  const auto all = sop_estimates<N>(t_s, value, covariance, independent);
  SopEstimate<N> out;
  const auto status = navigation::fuse_constants<N>(all, variance_per_s, at_s, out);
  return sop_result(status, sop_tuple(out));
}

template <int N>
SopEstimate<N> sop_one(const NumbersBase& value, const NumbersBase& covariance, bool independent) {
  if (value.span().size() != N || covariance.span().size() != N * N) {
    throw std::invalid_argument("value, covariance: " + std::to_string(N) + " numbers and a matrix of them expected");
  }
  SopEstimate<N> out;
  for (int k = 0; k < N; ++k) out.value[k] = value.span()[static_cast<std::size_t>(k)];
  for (int k = 0; k < N * N; ++k) out.covariance.data()[k] = covariance.span()[static_cast<std::size_t>(k)];
  out.independent = independent;
  return out;
}

template <int N>
py::tuple sop_intersect(const NumbersBase& a, const NumbersBase& A, const NumbersBase& b, const NumbersBase& B) {
  SopEstimate<N> left = sop_one<N>(a, A, false);
  const double weight = navigation::intersect(left, sop_one<N>(b, B, false));
  const py::tuple found = sop_tuple(left);
  return py::make_tuple(found[0], found[1], weight);
}

}  // namespace

void register_sop_catalog(py::module_& module) {
  module.def(
      "sop_move_clock",
      [](const Numbers<"value">& value, const Numbers<"covariance">& covariance, double h0, double h_minus_2,
         double dt_s) {
        SopEstimate<2> clock = sop_one<2>(value, covariance, true);
        if (!navigation::move_clock(clock, {h0, h_minus_2}, dt_s)) {
          throw std::invalid_argument("value, covariance, h0, h_minus_2, dt_s: finite numbers, h >= 0 expected");
        }
        return sop_tuple(clock);
      },
      py::arg("value"), py::arg("covariance"), py::kw_only(), py::arg("h0"), py::arg("h_minus_2"), py::arg("dt_s"),
      "Offset [s] and drift of a clock dt_s later, and their covariance.");
  module.def(
      "sop_fuse_clocks",
      [](const RealArray<"t_s">& t_s, const Numbers<"value">& value, const Numbers<"covariance">& covariance,
         const std::vector<bool>& independent, double h0, double h_minus_2, double at_s) {
        const auto all = sop_estimates<2>(t_s, value, covariance, independent);
        SopEstimate<2> out;
        const auto status = navigation::fuse_clocks(all, {h0, h_minus_2}, at_s, out);
        return sop_result(status, sop_tuple(out));
      },
      py::arg("t_s"), py::arg("value"), py::arg("covariance"), py::arg("independent"), py::kw_only(), py::arg("h0"),
      py::arg("h_minus_2"), py::arg("at_s"), "Estimates of one clock, ordered by time, fused at `at_s`.");
  module.def(
      "sop_fuse_constants",
      [](const RealArray<"t_s">& t_s, const Numbers<"value">& value, const Numbers<"covariance">& covariance,
         const std::vector<bool>& independent, double variance_per_s, double at_s) {
        const std::size_t size = t_s.size() == 0 ? 0 : value.span().size() / t_s.size();
        if (size == 2) return sop_fuse_constants<2>(t_s, value, covariance, independent, variance_per_s, at_s);
        if (size == 3) return sop_fuse_constants<3>(t_s, value, covariance, independent, variance_per_s, at_s);
        throw std::invalid_argument("value: shape (n, 2) or (n, 3) with n > 0 expected");
      },
      py::arg("t_s"), py::arg("value"), py::arg("covariance"), py::arg("independent"), py::kw_only(),
      py::arg("variance_per_s"), py::arg("at_s"), "Estimates of two or three constants, ordered by time, fused.");
  module.def(
      "sop_disagreement",
      [](const Numbers<"a">& a, const Numbers<"A">& A, const Numbers<"b">& b, const Numbers<"B">& B, bool independent) {
        const bool two = a.span().size() == 2;
        const double d2 = two ? navigation::disagreement(sop_one<2>(a, A, independent), sop_one<2>(b, B, independent))
                              : navigation::disagreement(sop_one<3>(a, A, independent), sop_one<3>(b, B, independent));
        return py::make_tuple(d2, regularized_gamma_q(two ? 1.0 : 1.5, 0.5 * d2));
      },
      py::arg("a"), py::arg("A"), py::arg("b"), py::arg("B"), py::arg("independent") = true,
      "Squared Mahalanobis distance of two estimates, and the probability of as much or more.");
  module.def(
      "sop_intersect",
      [](const Numbers<"a">& a, const Numbers<"A">& A, const Numbers<"b">& b, const Numbers<"B">& B) {
        return a.span().size() == 2 ? sop_intersect<2>(a, A, b, B) : sop_intersect<3>(a, A, b, B);
      },
      py::arg("a"), py::arg("A"), py::arg("b"), py::arg("B"),
      "Covariance intersection: value, covariance, weight of a.");
  module.def(
      "sop_least_variances",
      [](double h0, double h_minus_2, double duration_s) {
        return py::make_tuple(navigation::least_drift_variance({h0, h_minus_2}, duration_s),
                              navigation::least_ln_walk_variance({h0, h_minus_2}, duration_s));
      },
      py::arg("h0"), py::arg("h_minus_2"), py::arg("duration_s"),
      "Least variance of the drift and of ln h-2 that a record of this length allows.");
}

}  // namespace soopnav::python

#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "kalman.hpp"
#include "soopnav/estimation/covariance_check.hpp"
#include "soopnav/estimation/detail/gaussian_update.hpp"

/// Users' models: Python callables as the filters take models. An exception of the callable passes on.
namespace soopnav::python {

using RowMajorMatrixXd = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// What a callable returned, as numbers of that shape; ValueError "<what>: expected shape (2, 5), got ..." otherwise.
[[nodiscard]] RowMajorMatrixXd returned_matrix(py::handle object, const char* what, py::ssize_t rows,
                                               py::ssize_t columns);
/// The same of shape (rows,).
[[nodiscard]] Eigen::VectorXd returned_vector(py::handle object, const char* what, py::ssize_t rows);
/// The two of a pair; ValueError otherwise.
[[nodiscard]] std::pair<py::object, py::object> returned_pair(const py::object& object, const char* what);
/// A new array of that shape.
[[nodiscard]] py::array_t<double> new_array(std::span<const double> numbers, std::vector<py::ssize_t> shape);

namespace detail {

/// The sigma points of a filter that differ, one in each row: the mean, then those on either side of it.
template <int N, class Filter>
[[nodiscard]] py::array_t<double> sigma_array(const Filter& filter, int n) {
  std::array<ErasedState<N>, static_cast<std::size_t>(2 * N + 1)> points;
  if (!filter.sigma_points(points)) throw std::invalid_argument("P: has no root, so there are no sigma points");
  std::vector<double> numbers;
  for (int i = 0; i < 2 * N + 1; ++i) {
    if (i > 0 && (i - 1) % N >= n) continue;
    const auto& x = points[static_cast<std::size_t>(i)].x;
    numbers.insert(numbers.end(), x.data(), x.data() + n);
  }
  return new_array(numbers, {2 * n + 1, n});
}
/// The row of `sigma_array` where the filter's sigma point `i` lies: that of a component the state lacks is the mean.
template <int N>
[[nodiscard]] Eigen::Index sigma_row(Eigen::Index i, Eigen::Index n) noexcept {
  if (i == 0 || (i - 1) % N >= n) return 0;
  return i <= N ? i : i - N + n;
}

}  // namespace detail

/// The rows of a measurement that a callable predicts.
template <int N, bool kSigmaPoints>
class CallableRows {
 public:
  template <class Filter>
  CallableRows(const CallableMeasurement& model, std::size_t count, const Filter& filter, const RoleTable& roles)
      : f_(&model.f), n_(roles.size), count_(static_cast<py::ssize_t>(count)), next_(count, 0) {
    if constexpr (kSigmaPoints) {
      values_ = returned_matrix(model.f(detail::sigma_array<N>(filter, n_)), "h", 2 * n_ + 1, count_);
    }
    for (std::size_t i = 0; i < count; ++i) {
      rows_.push_back({this, &roles, &evaluate, static_cast<int>(i), model.angles[i]});
    }
  }
  CallableRows(const CallableRows&) = delete;
  CallableRows& operator=(const CallableRows&) = delete;

  [[nodiscard]] const std::vector<ErasedRow<N>>& rows() const noexcept { return rows_; }

 private:
  static bool evaluate(const void* context, int row, const RoleTable& /*roles*/, const double* x, double* z,
                       double* gradient) {
    // The rows are this object's own, which is not constant: it remembers where it was asked.
    auto& self = *static_cast<CallableRows*>(const_cast<void*>(context));  // NOLINT
    if constexpr (kSigmaPoints) {
      *z = self.values_(detail::sigma_row<N>(self.next_[static_cast<std::size_t>(row)]++, self.n_), row);
    } else {
      self.ask(x);
      *z = self.values_(row, 0);
      if (gradient != nullptr) std::copy_n(self.H_.row(row).data(), self.n_, gradient);
    }
    return true;
  }
  void ask(const double* x) {
    if (asked_ && std::equal(x, x + n_, at_.begin())) return;
    asked_ = false;
    const auto [h, H] = returned_pair((*f_)(new_array({x, static_cast<std::size_t>(n_)}, {n_})), "f(x)");
    values_ = returned_vector(h, "h", count_);
    H_ = returned_matrix(H, "H", count_, n_);
    std::copy_n(x, n_, at_.begin());
    asked_ = true;
  }

  const py::function* f_;
  int n_;
  py::ssize_t count_;
  std::vector<Eigen::Index> next_;
  RowMajorMatrixXd values_;
  RowMajorMatrixXd H_;
  std::array<double, static_cast<std::size_t>(N)> at_{};
  bool asked_ = false;
  std::vector<ErasedRow<N>> rows_;
};

/// A step that a callable predicts, with additive noise of covariance Q.
template <int N, bool kSigmaPoints>
class CallableProcess {
 public:
  using Input = std::array<double, 3>;
  static constexpr int kNoise = N;

  template <class Filter>
  CallableProcess(const py::function& f, std::span<const double> Q, const Filter& filter, int n, double dt_s) : n_(n) {
    const Eigen::MatrixXd covariance = Eigen::Map<const Eigen::MatrixXd>(Q.data(), n, n);
    check_covariance(covariance, "Q");
    Eigen::MatrixXd root(n, n);
    if (!soopnav::detail::semidefinite_root(covariance, root)) {
      throw std::invalid_argument("Q: not positive semi-definite");
    }
    root_.topLeftCorner(n, n) = root;
    if constexpr (kSigmaPoints) {
      next_ = returned_matrix(f(detail::sigma_array<N>(filter, n), dt_s), "x_next", 2 * n + 1, n);
    } else {
      const std::span<const double> x(filter.state().x.data(), static_cast<std::size_t>(n));
      const auto [next, F] = returned_pair(f(new_array(x, {n}), dt_s), "f(x, dt_s)");
      next_ = returned_vector(next, "x_next", n).transpose();
      F_.topLeftCorner(n, n) = returned_matrix(F, "F", n, n);
    }
  }

  template <class W, class Y>
  [[nodiscard]] bool propagate(const ErasedState<N>& /*x*/, const Input& /*u*/, double /*dt_s*/, const W& /*w*/,
                               Y& y) const {
    y.state.x.head(n_) = next_.row(kSigmaPoints ? detail::sigma_row<N>(asked_++, n_) : 0).transpose();
    if constexpr (Y::kJacobian) {
      y.F = F_;
      y.G = root_;
      y.F_asked = ~std::uint64_t{0};
      y.G_asked = ~std::uint64_t{0};
    }
    return true;
  }

 private:
  Eigen::Index n_;
  RowMajorMatrixXd next_;
  Eigen::Matrix<double, N, N> F_ = Eigen::Matrix<double, N, N>::Identity();
  Eigen::Matrix<double, N, N> root_ = Eigen::Matrix<double, N, N>::Zero();
  mutable Eigen::Index asked_ = 0;
};

}  // namespace soopnav::python

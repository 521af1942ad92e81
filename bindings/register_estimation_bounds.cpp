#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cmath>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <tuple>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/estimation/fisher_information.hpp"
#include "soopnav/estimation/observability.hpp"
#include "soopnav/estimation/posterior_crlb.hpp"
#include "soopnav/estimation/statistics.hpp"
#include "soopnav/estimation/unobservable.hpp"
#include "soopnav/measurement/azimuth.hpp"
#include "soopnav/measurement/range.hpp"

namespace soopnav::python {

namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using Array = py::array_t<double>;

MatrixXd matrix(const TableBase& table) {
  MatrixXd m(static_cast<Index>(table.rows()), static_cast<Index>(table.columns()));
  for (std::size_t i = 0; i < table.rows(); ++i) {
    for (std::size_t j = 0; j < table.columns(); ++j) m(static_cast<Index>(i), static_cast<Index>(j)) = table.row(i)[j];
  }
  return m;
}

template <class Derived>
void append(std::vector<double>& values, const Eigen::DenseBase<Derived>& m) {
  for (Index i = 0; i < m.rows(); ++i) {
    for (Index j = 0; j < m.cols(); ++j) values.push_back(m(i, j));
  }
}

Array array(const MatrixXd& m) {
  std::vector<double> values;
  values.reserve(static_cast<std::size_t>(m.size()));
  append(values, m);
  return to_array(std::move(values), {m.rows(), m.cols()});
}

Array array(const VectorXd& v) { return to_array(std::vector<double>(v.begin(), v.end())); }

// A table of `count` squares or blocks one below the other; one of them stands for all.
class Series {
 public:
  Series(const TableBase& table, Index rows, Index count, const char* name) : all_(matrix(table)), rows_(rows) {
    if (all_.rows() != rows && all_.rows() != rows * count) {
      throw std::invalid_argument(std::string(name) + ": " + std::to_string(all_.rows()) + " rows; " +
                                  std::to_string(rows) + " or " + std::to_string(rows * count) + " expected");
    }
    if (!all_.allFinite()) throw std::invalid_argument(std::string(name) + ": it holds NaN or infinity");
    one_ = all_.rows() == rows;
  }
  [[nodiscard]] auto operator[](Index i) const { return all_.middleRows(one_ ? 0 : i * rows_, rows_); }
  [[nodiscard]] Index columns() const { return all_.cols(); }
  [[nodiscard]] bool varies() const { return !one_; }

 private:
  MatrixXd all_;
  Index rows_;
  bool one_ = false;
};

using BoundTuple = std::tuple<int, Array, Array, Array, Array, Array, std::vector<std::string>>;

BoundTuple crlb(const Table<"H">& H, const Table<"R">& R, const std::optional<Table<"prior_information">>& prior,
                const std::vector<std::string>& names, double tolerance) {
  const MatrixXd h = matrix(H);
  const MatrixXd r = matrix(R);
  const MatrixXd p = prior ? matrix(*prior) : MatrixXd();
  CramerRaoBound<Eigen::Dynamic> bound;
  std::vector<std::string> free;
  {
    const py::gil_scoped_release release;
    bound = cramer_rao_bound(h, r, p, tolerance);
    const std::vector<std::string_view> views(names.begin(), names.end());
    free = name_directions(bound.unobservable, views);
  }
  return {bound.rank,         array(bound.information),     array(bound.covariance),
          array(bound.sigma), array(bound.singular_values), array(MatrixXd(bound.unobservable)),
          std::move(free)};
}

std::pair<Array, py::array_t<std::int64_t>> crlb_series(const Table<"H">& H, std::size_t count, const Table<"R">& R,
                                                        double tolerance) {
  const MatrixXd h = matrix(H);
  const MatrixXd r = matrix(R);
  const auto sets = static_cast<Index>(count);
  if (sets < 1 || h.rows() % sets != 0) {
    throw std::invalid_argument("H: " + std::to_string(h.rows()) + " rows in " + std::to_string(count) + " sets");
  }
  std::vector<double> sigma;
  std::vector<std::int64_t> rank;
  {
    const py::gil_scoped_release release;
    const Index m = h.rows() / sets;
    sigma.reserve(static_cast<std::size_t>(sets * h.cols()));
    for (Index k = 0; k < sets; ++k) {
      const auto rows = h.middleRows(k * m, m);
      // A geometry without a Jacobian (a receiver on top of a node) says nothing.
      if (!rows.allFinite()) {
        append(sigma, VectorXd::Constant(h.cols(), std::numeric_limits<double>::quiet_NaN()));
        rank.push_back(0);
        continue;
      }
      const auto bound = cramer_rao_bound(rows, r, MatrixXd(), tolerance);
      append(sigma, bound.sigma);
      rank.push_back(bound.rank);
    }
  }
  return {to_array(std::move(sigma), {sets, h.cols()}), to_array(std::move(rank))};
}

// P and P_pred, (steps, n, n) each.
std::pair<Array, Array> posterior_crlb(const Table<"F">& F, const Table<"Q">& Q, const Table<"H">& H,
                                       const Table<"R">& R, const Table<"P0">& P0, std::size_t steps,
                                       std::size_t samples, std::size_t rows) {
  const auto count = static_cast<Index>(steps);
  const auto s = static_cast<Index>(samples);
  const auto m = static_cast<Index>(rows);
  const MatrixXd p0 = matrix(P0);
  const Index n = p0.rows();
  // `samples` matrices of one step stand one below the other.
  const Series f(F, n * s, count, "F");
  const Series h(H, m * s, count, "H");
  const Series q(Q, n, count, "Q");
  const Series r(R, m, count, "R");
  if (f.columns() != n || h.columns() != n || q.columns() != n || r.columns() != m) {
    throw std::invalid_argument("F, Q, H, R: columns do not fit the " + std::to_string(n) + " states of P0");
  }
  for (Index k = 0; k < (q.varies() ? count : 1); ++k) check_covariance(q[k], "Q", s > 1);
  for (Index k = 0; k < (r.varies() ? count : 1); ++k) check_covariance(r[k], "R", true);
  PosteriorCrlb<Eigen::Dynamic> bound(p0);
  std::vector<double> updated;
  std::vector<double> predicted;
  {
    const py::gil_scoped_release release;
    updated.reserve(static_cast<std::size_t>(count * n * n));
    predicted.reserve(static_cast<std::size_t>(count * n * n));
    for (Index k = 0; k < count; ++k) {
      bool good = true;
      if (s == 1) {
        const auto root = information_root<Eigen::Dynamic>(MatrixXd(q[k]));
        good = root && bound.predict(f[k], root->transpose());
      } else {
        const Eigen::LLT<MatrixXd> llt(q[k]);
        const MatrixXd d22 = llt.solve(MatrixXd::Identity(n, n));
        MatrixXd d11 = MatrixXd::Zero(n, n);
        MatrixXd d12 = MatrixXd::Zero(n, n);
        for (Index i = 0; i < s; ++i) {
          const auto F_i = f[k].middleRows(i * n, n);
          d12 -= F_i.transpose() * d22 / static_cast<double>(s);
          d11 += F_i.transpose() * d22 * F_i / static_cast<double>(s);
        }
        good = bound.predict_expected(d11, d12, d22);
      }
      if (!good) {
        throw std::invalid_argument("F: step " + std::to_string(k) +
                                    " cannot be taken: F is singular and Q leaves what it forgets without noise");
      }
      append(predicted, bound.bound().covariance);
      MatrixXd seen = MatrixXd::Zero(n, n);
      if (s == 1) {
        good = bound.update(h[k], r[k]);
      } else {
        const Eigen::LLT<MatrixXd> llt(r[k]);
        for (Index i = 0; i < s; ++i) {
          const MatrixXd H_i = h[k].middleRows(i * m, m);
          seen += H_i.transpose() * llt.solve(H_i) / static_cast<double>(s);
        }
        good = bound.update_expected(0.5 * (seen + seen.transpose()));
      }
      if (!good) throw std::invalid_argument("R: it must be positive definite at step " + std::to_string(k));
      append(updated, bound.bound().covariance);
    }
  }
  return {to_array(std::move(updated), {count, n, n}), to_array(std::move(predicted), {count, n, n})};
}

// d z / d position of every node (L) from every position (N): (N, L, 3); NaN where it is undefined.
template <class Model>
void gradients(const MatrixXd& nodes, const MatrixXd& positions, std::vector<double>& out) {
  using State = ComposedState<PlanarFrame, Role<3, PositionTag>>;
  for (Index i = 0; i < positions.rows(); ++i) {
    State x;
    x.x = positions.row(i).transpose();
    for (Index j = 0; j < nodes.rows(); ++j) {
      const Eigen::Vector3d node = nodes.row(j).transpose();
      Prediction<1, State> y;
      const bool defined = Model{node}.predict(x, y);
      for (Index k = 0; k < 3; ++k) out.push_back(defined ? y.H(0, k) : std::numeric_limits<double>::quiet_NaN());
    }
  }
}

Array position_jacobian(const std::string& kind, const Table<"nodes_m">& nodes, const Table<"positions_m">& positions) {
  const MatrixXd q = matrix(nodes);
  const MatrixXd p = matrix(positions);
  if (q.cols() != 3 || p.cols() != 3) {
    throw std::invalid_argument(std::string(q.cols() != 3 ? "nodes_m" : "positions_m") + ": three columns expected");
  }
  std::vector<double> values;
  values.reserve(static_cast<std::size_t>(q.rows() * p.rows() * 3));
  {
    const py::gil_scoped_release release;
    if (kind == "range") {
      gradients<Range<PlanarFrame>>(q, p, values);
    } else if (kind == "azimuth") {
      gradients<Azimuth<PlanarFrame, Known<1>, Known<3>>>(q, p, values);
    } else {
      throw std::invalid_argument("kind: '" + kind + "'; 'range' or 'azimuth' expected");
    }
  }
  return to_array(std::move(values), {p.rows(), q.rows(), 3});
}

void check_runs(int runs, double failure_probability) {
  if (runs < 1) throw std::invalid_argument("runs: " + std::to_string(runs) + "; at least 1 expected");
  if (!(failure_probability > 0.0 && failure_probability < 1.0)) {
    throw std::invalid_argument("failure_probability: " + std::to_string(failure_probability) +
                                " is not between 0 and 1");
  }
}

}  // namespace

void register_estimation_bounds(py::module_& m) {
  m.attr("RANK_TOLERANCE") = kRankTolerance;
  m.def("crlb", &crlb, py::arg("H"), py::arg("R"), py::arg("prior_information"), py::arg("names"), py::arg("tolerance"),
        "Rank, information, covariance, sigma, singular values, unobservable basis and its directions in words.");
  m.def("crlb_series", &crlb_series, py::arg("H"), py::arg("count"), py::arg("R"), py::arg("tolerance"),
        "Sigma (count, n) and rank (count,) of as many Jacobians one below the other; NaN where one is not finite.");
  m.def("posterior_crlb", &posterior_crlb, py::arg("F"), py::arg("Q"), py::arg("H"), py::arg("R"), py::arg("P0"),
        py::arg("steps"), py::arg("samples"), py::arg("rows"), "P and P_pred, (steps, n, n) each.");
  m.def(
      "observability_matrix",
      [](const Table<"F">& F, const Table<"H">& H, std::size_t rows, std::size_t steps) {
        const MatrixXd f = matrix(F);
        const MatrixXd h = matrix(H);
        MatrixXd stack;
        {
          const py::gil_scoped_release release;
          stack = observability_matrix(f, h, static_cast<Index>(rows), static_cast<Index>(steps));
        }
        return array(stack);
      },
      py::arg("F"), py::arg("H"), py::arg("rows"), py::arg("steps"), "[H_0; H_1 F_0; H_2 F_1 F_0; ...].");
  m.def(
      "marginal_information",
      [](const Table<"information">& information, const std::vector<int>& kept) {
        const auto root = information_root<Eigen::Dynamic>(matrix(information));
        if (!root) {
          throw std::invalid_argument("information: it must be finite, symmetric and positive semidefinite");
        }
        return array(marginal_information<Eigen::Dynamic, Eigen::Dynamic>(*root, kept));
      },
      py::arg("information"), py::arg("kept"), "Schur complement: information when the other parameters are unknown.");
  m.def("position_jacobian", &position_jacobian, py::arg("kind"), py::arg("nodes_m"), py::arg("positions_m"),
        "Derivative of every node's measurement by every position, (positions, nodes, 3).");

  m.def(
      "nees_series",
      [](const Table<"errors">& errors, const Table<"P">& P) {
        const MatrixXd e = matrix(errors);
        const MatrixXd p = matrix(P);
        VectorXd values;
        {
          const py::gil_scoped_release release;
          values = nees_series(e, p);
        }
        return array(values);
      },
      py::arg("errors"), py::arg("P"), "NEES of each row, NaN where it has none.");
  m.def(
      "mean_nees_bounds",
      [](double dof, int runs, double failure_probability) {
        if (!(dof > 0.0)) throw std::invalid_argument("dof: " + std::to_string(dof) + " is not positive");
        check_runs(runs, failure_probability);
        const MeanBounds bounds = mean_nees_bounds(dof, runs, failure_probability);
        return std::pair(bounds.lower, bounds.upper);
      },
      py::arg("dof"), py::arg("runs"), py::arg("failure_probability"), "Lower and upper bound of a mean of NEES.");
  m.def(
      "coverage_bounds",
      [](double probability, int runs, double failure_probability) {
        if (!(probability > 0.0 && probability < 1.0)) {
          throw std::invalid_argument("probability: " + std::to_string(probability) + " is not between 0 and 1");
        }
        check_runs(runs, failure_probability);
        const MeanBounds bounds = coverage_bounds(probability, runs, failure_probability);
        return std::pair(bounds.lower, bounds.upper);
      },
      py::arg("probability"), py::arg("runs"), py::arg("failure_probability"), "Lower and upper bound of a share.");
  m.def(
      "coverage",
      [](const Table<"errors">& errors, const Table<"P">& P, double probability) {
        return coverage(matrix(errors), matrix(P), probability);
      },
      py::arg("errors"), py::arg("P"), py::arg("probability"), "Share of the errors inside their region.");
  m.def(
      "rmse", [](const Table<"errors">& errors) { return array(rmse(matrix(errors))); }, py::arg("errors"),
      "Root mean square of each component.");
  m.def(
      "sample_circular_error_m",
      [](const Table<"errors_m">& errors, double probability) {
        return sample_circular_error_m(matrix(errors), probability);
      },
      py::arg("errors_m"), py::arg("probability"), "Radius that so many of the errors do not exceed.");
}

}  // namespace soopnav::python

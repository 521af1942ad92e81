#include "soopnav/navigation/position_fix.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <concepts>
#include <cstdio>
#include <stdexcept>

#include "soopnav/core/constants.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/estimation/least_squares.hpp"
#include "soopnav/estimation/unobservable.hpp"
#include "soopnav/measurement/pseudorange.hpp"

namespace soopnav::navigation {
namespace {

constexpr int kMaxRows = static_cast<int>(kMaxNodes);
using Spatial = PositionClock<EnuFrame>;
using Planar = PlanarPositionClock<EnuFrame>;
using Model = Pseudorange<EnuFrame>;
using Indices = StaticVector<std::size_t, kMaxNodes>;

// The measurements of all usable nodes, about the nodes' centroid and a common reference time.
struct Data {
  Indices usable;
  std::array<Eigen::Vector3d, kMaxNodes> position;  // by node
  std::array<double, kMaxNodes> rho;                // c * (arrival - reference) [m]
  std::array<double, kMaxNodes> sigma;              // [m]
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  double reference_s = 0.0;
};

double wrapped(double t, double period) {
  if (!std::isfinite(period)) return t;
  const double r = t - period * std::floor(t / period + 0.5);
  return r < 0.5 * period ? r : r - period;
}

Data gather(std::span<const Node> nodes, std::span<const double> toas_s, std::span<const double> sigmas_s,
            double period, PositionFix& fix) {
  Data data;
  double c = 0.0;
  double s = 0.0;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const bool finite = std::isfinite(toas_s[i]) && std::isfinite(sigmas_s[i]);
    const NodeUse use = !finite ? NodeUse::kNotFinite : !(sigmas_s[i] > 0.0) ? NodeUse::kBadSigma : NodeUse::kUsed;
    static_cast<void>(fix.use.push_back(use));
    if (use != NodeUse::kUsed) continue;
    static_cast<void>(data.usable.push_back(i));
    data.origin += nodes[i].position_m;
    if (std::isfinite(period)) {
      const double phase = kTwoPi * wrapped(toas_s[i] - nodes[i].clock_offset_s, period) / period;
      c += std::cos(phase);
      s += std::sin(phase);
    }
  }
  if (data.usable.empty()) return data;
  data.origin /= static_cast<double>(data.usable.size());
  // The circular mean: a single wrong arrival cannot push the good ones across the wrap.
  const std::size_t first = data.usable.front();
  data.reference_s =
      std::isfinite(period) ? std::atan2(s, c) / kTwoPi * period : toas_s[first] - nodes[first].clock_offset_s;
  for (const std::size_t i : data.usable) {
    data.position[i] = nodes[i].position_m - data.origin;
    data.rho[i] = kSpeedOfLightMps * wrapped(toas_s[i] - nodes[i].clock_offset_s - data.reference_s, period);
    data.sigma[i] = kSpeedOfLightMps * std::hypot(sigmas_s[i], nodes[i].sigma_s);
  }
  return data;
}

template <class State>
State make_state(const Eigen::Vector3d& position, double clock) {
  if constexpr (std::same_as<State, Planar>) {
    return Planar::make(position, clock);
  } else {
    Spatial state;
    state.x << position, clock;
    return state;
  }
}

// Where the tangent components of a state go among east, north, up, clock.
template <class State>
constexpr std::array<int, static_cast<std::size_t>(State::kDim)> places() {
  if constexpr (std::same_as<State, Planar>) {
    return {3, 0, 1};
  } else {
    return {0, 1, 2, 3};
  }
}

// A fit to some of the nodes, whatever its dimension.
struct Fit {
  SolveStatus status = SolveStatus::kUndefined;
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  double clock = 0.0;
  Eigen::Matrix4d covariance = Eigen::Matrix4d::Constant(PositionFix::kNan);  // east, north, up, clock
  Dop dop;
  double chi_square = PositionFix::kNan;
  int dof = 0;
  std::array<double, kMaxNodes> residual{};  // in the order of the indices
  std::array<double, kMaxNodes> normalized{};
  std::array<double, kMaxNodes> redundancy{};
  Eigen::Matrix<double, 4, Eigen::Dynamic, 0, 4, 4> unobservable{4, 0};
  Eigen::Matrix<double, 4, Eigen::Dynamic, 0, 4, 4> alternatives{4, 0};
};

template <class State>
Fit read_result(const MultiStartResult<State, kMaxRows>& result) {
  constexpr auto kPlaces = places<State>();
  const auto& best = result.best;
  Fit fit;
  fit.status = best.status;
  fit.position = best.state(kPosition);
  fit.clock = best.state(kClockBias)[0];
  fit.dop = best.dop;
  fit.chi_square = best.chi_square;
  fit.dof = best.degrees_of_freedom;
  fit.covariance.setZero();
  for (std::size_t i = 0; i < kPlaces.size(); ++i) {
    for (std::size_t j = 0; j < kPlaces.size(); ++j) {
      fit.covariance(kPlaces[i], kPlaces[j]) = best.covariance(static_cast<int>(i), static_cast<int>(j));
    }
  }
  for (Eigen::Index i = 0; i < best.residuals.size(); ++i) {
    fit.residual[static_cast<std::size_t>(i)] = best.residuals[i];
    fit.normalized[static_cast<std::size_t>(i)] = best.normalized_residuals[i];
    fit.redundancy[static_cast<std::size_t>(i)] = best.redundancy[i];
  }
  fit.unobservable.setZero(4, best.unobservable.cols());
  for (std::size_t i = 0; i < kPlaces.size(); ++i) {
    if (best.unobservable.cols() > 0) fit.unobservable.row(kPlaces[i]) = best.unobservable.row(static_cast<int>(i));
  }
  fit.alternatives.resize(4, result.alternative_count);
  for (int i = 0; i < result.alternative_count; ++i) {
    const auto& other = result.alternatives[static_cast<std::size_t>(i)].state;
    fit.alternatives.col(i) << other(kPosition), other(kClockBias)[0];
  }
  return fit;
}

// The line (planar) or plane (spatial) nearest to the nodes.
struct Sheet {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  double thickness = 0.0;  // spread across it over the largest spread along it
};

Sheet normal_of(const Data& data, const Indices& nodes, bool planar) {
  Sheet sheet;
  for (const std::size_t i : nodes) sheet.centre += data.position[i] / static_cast<double>(nodes.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const std::size_t i : nodes) {
    Eigen::Vector3d d = data.position[i] - sheet.centre;
    if (planar) d[2] = 0.0;
    scatter += d * d.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(scatter);
  // In a plane the smallest eigenvalue is that of the vertical, by construction.
  if (planar) {
    const Eigen::Vector3d along = eigen.eigenvectors().col(2);
    sheet.normal = Eigen::Vector3d(-along[1], along[0], 0.0).normalized();
  } else {
    sheet.normal = eigen.eigenvectors().col(0);
  }
  const double across = std::max(eigen.eigenvalues()[planar ? 1 : 0], 0.0);
  sheet.thickness = eigen.eigenvalues()[2] > 0.0 ? std::sqrt(across / eigen.eigenvalues()[2]) : 0.0;
  return sheet;
}

// Whether they lie in it, to 2 % of their spread.
bool in_line(const Data& data, const Indices& nodes, bool planar) {
  constexpr double kThin = 0.02;
  return normal_of(data, nodes, planar).thickness <= kThin;
}

// A position's coordinate along a direction.
struct OnSheet {
  static constexpr int kDim = 1;
  Eigen::Vector3d normal;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    y.value(0) = normal.dot(x(kPosition));
    if constexpr (Y::kJacobian) y.jacobian(kPosition) = normal.transpose();
    return true;
  }
};

bool is_solution(const Fit& fit) {
  return fit.status == SolveStatus::kConverged || fit.status == SolveStatus::kAmbiguous;
}

struct Solver {
  const Data& data;
  const PositionFixOptions& options;
  std::optional<double> height;  // about the origin; planar when given

  [[nodiscard]] int unknowns() const { return height ? 3 : 4; }
  // `thorough`: a solution that does not explain the data is not taken before all around the nodes was searched.
  [[nodiscard]] Fit fit(const Indices& nodes, bool thorough) const {
    return height ? fit_as<Planar>(nodes, thorough) : fit_as<Spatial>(nodes, thorough);
  }

  template <class State>
  [[nodiscard]] Fit fit_as(const Indices& nodes, bool thorough) const {
    const auto n = static_cast<Eigen::Index>(nodes.size());
    std::array<Observed<Model>, kMaxNodes> observed;
    Eigen::Matrix<double, 3, Eigen::Dynamic, 0, 3, kMaxRows> positions(3, n);
    Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxRows, 1> rho(n);
    for (std::size_t k = 0; k < nodes.size(); ++k) {
      const std::size_t i = nodes[k];
      observed[k] = Observed<Model>({data.position[i]}, data.rho[i], data.sigma[i] * data.sigma[i]);
      positions.col(static_cast<Eigen::Index>(k)) = data.position[i];
      rho[static_cast<Eigen::Index>(k)] = data.rho[i];
    }
    const std::span<const Observed<Model>> group(observed.data(), nodes.size());
    const int dof = static_cast<int>(nodes.size()) - State::kDim;
    // The second answer of a mirror or of the minimum of nodes is another position however near; with nodes to spare,
    // two minima within a standard deviation are one.
    const bool two_answers = dof == 0 || in_line(data, nodes, height.has_value());
    const LeastSquaresOptions solver_options{.max_iterations = options.max_iterations,
                                             .distinct_sigmas = two_answers ? 1e-3 : 1.0};
    const double ambiguity = chi_square_upper_quantile(options.false_alarm_probability, 1.0);

    constexpr std::size_t kMaxStarts = 24;
    std::array<State, kMaxStarts> starts;
    std::size_t count = 0;
    std::array<ClosedFormFix, 3> candidates;
    const int found = closed_form_fixes(positions, rho, height, candidates);
    for (int i = 0; i < found; ++i) {
      const ClosedFormFix& c = candidates[static_cast<std::size_t>(i)];
      starts[count++] = make_state<State>(c.position_m, c.clock_bias_m);
    }
    auto result = solve_from<kMaxRows>(std::span<const State>(starts.data(), count), solver_options, ambiguity, group);
    const bool solved = result.best.status == SolveStatus::kConverged ||
                        result.best.status == SolveStatus::kAmbiguous ||
                        result.best.status == SolveStatus::kRankDeficient;
    const bool explains = dof <= 0 || !thorough ||
                          result.best.chi_square <= chi_square_upper_quantile(options.false_alarm_probability, dof);
    if (!solved || !explains) {
      // Far from the data's model: look all around the nodes for a deeper valley.
      const Eigen::Vector3d centre = positions.rowwise().mean();
      const double spread = std::sqrt((positions.colwise() - centre).colwise().squaredNorm().mean());
      for (const double radius : {0.7 * spread, 3.0 * spread}) {
        for (int k = 0; k < 8; ++k) {
          const double angle = kTwoPi * k / 8.0;
          Eigen::Vector3d p =
              centre + radius * Eigen::Vector3d(std::cos(angle), std::sin(angle), k % 2 == 0 ? 0.3 : -0.3);
          if (height) p[2] = *height;
          const double clock = (rho - (positions.colwise() - p).colwise().norm().transpose()).mean();
          starts[count++] = make_state<State>(p, clock);
        }
      }
      result = solve_from<kMaxRows>(std::span<const State>(starts.data(), count), solver_options, ambiguity, group);
    }
    choose(result);
    Fit fit = read_result(result);
    if (is_solution(fit)) {
      refuse_weak(fit, positions);
      if (is_solution(fit) && crosses_plane<State>(nodes, result.best, solver_options, ambiguity, group)) {
        fit.status = SolveStatus::kRankDeficient;
        fit.unobservable.setZero(4, 1);
        fit.unobservable.col(0).head<3>() = normal_of(data, nodes, height.has_value()).normal;
      }
    } else if (fit.status == SolveStatus::kNotConverged && fit.covariance.allFinite() &&
               fit.chi_square <= chi_square_upper_quantile(options.false_alarm_probability, std::max(dof, 1))) {
      // The data are explained and yet there is no minimum: the sum of squares is flat, and flattest along this.
      fit.status = SolveStatus::kRankDeficient;
      fit.unobservable = Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d>(fit.covariance).eigenvectors().rightCols<1>();
    }
    return fit;
  }

  // Whether the data allow the whole way from the fit to the line or plane the nodes nearly lie in. Between a position
  // and its mirror image the sum of squares has a ridge there, a quarter as high as the fit's own covariance has it
  // (doc/position_fix.md eq. 14). Where noise drowns the ridge, that covariance says nothing.
  template <class State>
  [[nodiscard]] bool crosses_plane(const Indices& nodes, const LeastSquaresResult<State, kMaxRows>& best,
                                   const LeastSquaresOptions& solver_options, double gate,
                                   std::span<const Observed<Model>> group) const {
    const Sheet sheet = normal_of(data, nodes, height.has_value());
    constexpr double kThick = 0.3;
    if (sheet.thickness > kThick) return false;
    const Eigen::Vector3d position = best.state(kPosition);
    const double distance = sheet.normal.dot(position - sheet.centre);
    typename State::Tangent along = State::Tangent::Zero();
    constexpr auto kPlaces = places<State>();
    for (std::size_t i = 0; i < kPlaces.size(); ++i) {
      if (kPlaces[i] < 3) along[static_cast<Eigen::Index>(i)] = sheet.normal[kPlaces[i]];
    }
    const double variance = along.dot(best.covariance * along);
    const double expected = distance * distance / variance;
    constexpr double kHeld = 1e-4;  // variance of the constraint [m²]
    const Observed<OnSheet> constraint({sheet.normal}, sheet.normal.dot(sheet.centre), kHeld);
    const auto held = solve<kMaxRows + 1>(best.state.retract(-distance * along), solver_options, group, constraint);
    if (held.status != SolveStatus::kConverged) return false;
    const double off = held.residuals[held.residuals.size() - 1];
    const double ridge = held.chi_square - off * off / kHeld - best.chi_square;
    return ridge <= gate && ridge < 0.5 * expected;
  }

  // Among positions that fit equally: the hinted one, else the better fit, else the nearest to the nodes, else the
  // lower.
  template <class State>
  void choose(MultiStartResult<State, kMaxRows>& result) const {
    const Eigen::Vector3d hint =
        options.near_m ? Eigen::Vector3d(*options.near_m - data.origin) : Eigen::Vector3d::Zero();
    for (int i = 0; i < result.alternative_count; ++i) {
      auto& other = result.alternatives[static_cast<std::size_t>(i)];
      constexpr double kEqualFit = 1e-6;
      if (!options.near_m && std::abs(other.chi_square - result.best.chi_square) > kEqualFit) continue;
      const Eigen::Vector3d there = other.state(kPosition);
      const Eigen::Vector3d here = result.best.state(kPosition);
      const double gain = (here - hint).norm() - (there - hint).norm();
      const double tie = 1e-6 * (1.0 + (here - hint).norm());
      if (gain > tie || (gain >= -tie && there[2] < here[2])) {
        std::swap(other, result.best);
        std::swap(other.status, result.best.status);
      }
    }
  }

  // An uncertainty beyond the distance to the nodes is no longer that of the linearised problem: not determined.
  static void refuse_weak(Fit& fit, const Eigen::Matrix<double, 3, Eigen::Dynamic, 0, 3, kMaxRows>& positions) {
    const double distance = (positions.colwise() - fit.position).colwise().norm().mean();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> eigen(fit.covariance);
    if (!(fit.covariance.topLeftCorner<3, 3>().trace() > distance * distance)) return;
    fit.status = SolveStatus::kRankDeficient;
    fit.unobservable = eigen.eigenvectors().rightCols<1>();
  }
};

// A fit and the nodes it took and left.
struct Outcome {
  FixStatus status = FixStatus::kTooFewNodes;
  Fit fit;
  Indices used;
  Indices rejected;
  Indices suspects;
  std::array<double, kMaxNodes> rejected_residual{};
  std::array<double, kMaxNodes> rejected_gate{};
  double gate_sigmas = PositionFix::kNan;
};

// Residual of a node left out of the fit, and its gate: k times the standard deviation of the prediction and the node.
void predict_rejected(const Data& data, std::size_t node, const Fit& fit, double k, double& residual, double& gate) {
  const Eigen::Vector3d from = fit.position - data.position[node];
  const double range = from.norm();
  residual = data.rho[node] - range - fit.clock;
  Eigen::Vector4d row = Eigen::Vector4d::UnitW();
  if (range > 0.0) row.head<3>() = from / range;
  gate = k * std::sqrt(data.sigma[node] * data.sigma[node] + row.dot(fit.covariance * row));
}

// The best fit without one or two of the nodes, and who else might be left out instead.
struct Removal {
  std::array<std::size_t, 2> at{};  // places among the indices, ascending
  std::size_t count = 0;
  Fit fit;
  double runner_up = std::numeric_limits<double>::infinity();
};

Indices without(const Indices& nodes, const std::array<std::size_t, 2>& at, std::size_t count) {
  Indices rest = nodes;
  for (std::size_t k = count; k-- > 0;) rest.erase_at(at[k]);
  return rest;
}

// Leaves out each node (count 1) or each pair (count 2) in turn; `chi_without` takes the chi-square without each node.
Removal best_removal(const Solver& solver, const Indices& nodes, std::size_t count,
                     std::array<double, kMaxNodes>* chi_without = nullptr) {
  Removal best;
  best.count = count;
  best.fit.chi_square = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    for (std::size_t j = count == 1 ? i : i + 1; j < (count == 1 ? i + 1 : nodes.size()); ++j) {
      const std::array<std::size_t, 2> at{i, j};
      const Fit trial = solver.fit(without(nodes, at, count), false);
      const double chi = is_solution(trial) ? trial.chi_square : std::numeric_limits<double>::infinity();
      if (chi_without != nullptr) (*chi_without)[i] = chi;
      if (chi < best.fit.chi_square) {
        best.runner_up = best.fit.chi_square;
        best.fit = trial;
        best.at = at;
      } else {
        best.runner_up = std::min(best.runner_up, chi);
      }
    }
  }
  return best;
}

// Whether all nodes of a removal lie outside the gate of the fit without them.
bool outside_gate(const Data& data, const Indices& nodes, const Removal& removal, double gate_sigmas) {
  for (std::size_t k = 0; k < removal.count; ++k) {
    double residual = 0.0;
    double gate = 0.0;
    predict_rejected(data, nodes[removal.at[k]], removal.fit, gate_sigmas, residual, gate);
    if (!(std::abs(residual) > gate)) return false;
  }
  return true;
}

Outcome attempt(const Solver& solver) {
  const Data& data = solver.data;
  const double false_alarm = solver.options.false_alarm_probability;
  const int unknowns = solver.unknowns();
  Outcome out;
  out.used = data.usable;
  if (static_cast<int>(out.used.size()) < unknowns) return out;
  out.fit = solver.fit(out.used, true);
  const auto limit = [&](int dof) { return chi_square_upper_quantile(false_alarm, std::max(dof, 1)); };
  // A second choice as good as the first: with equal priors the odds are exp(difference / 2), and 19 to 1 are wanted.
  const double separation = 2.0 * std::log(19.0);
  bool consistent = true;
  while (true) {
    const int dof = static_cast<int>(out.used.size()) - unknowns;
    // Each node's share of the false alarms (Bonferroni).
    out.gate_sigmas = normal_two_sided_gate(false_alarm / static_cast<double>(out.used.size()));
    double worst = 0.0;
    for (std::size_t k = 0; k < out.used.size(); ++k) worst = std::max(worst, std::abs(out.fit.normalized[k]));
    consistent = out.fit.chi_square <= limit(dof);
    if ((consistent && worst <= out.gate_sigmas) || dof < 2 || !solver.options.reject_outliers) break;

    std::array<double, kMaxNodes> chi_without{};
    Removal removal = best_removal(solver, out.used, 1, &chi_without);
    if (!(removal.fit.chi_square <= limit(dof - 1))) {
      // One node does not explain it. Two wrong nodes can hide each other from a search one at a time.
      constexpr std::size_t kMostForPairs = 20;
      if (dof >= 3 && out.used.size() <= kMostForPairs) {
        const Removal pair = best_removal(solver, out.used, 2);
        const bool explains =
            pair.fit.chi_square <= limit(dof - 2) && pair.runner_up - pair.fit.chi_square > separation;
        if (explains && outside_gate(data, out.used, pair, out.gate_sigmas)) removal = pair;
      }
    } else if (removal.runner_up - removal.fit.chi_square < separation) {
      for (std::size_t k = 0; !consistent && k < out.used.size(); ++k) {
        if (chi_without[k] - removal.fit.chi_square < separation)
          static_cast<void>(out.suspects.push_back(out.used[k]));
      }
      break;
    }
    if (!std::isfinite(removal.fit.chi_square) || !outside_gate(data, out.used, removal, out.gate_sigmas)) break;
    for (std::size_t k = 0; k < removal.count; ++k) static_cast<void>(out.rejected.push_back(out.used[removal.at[k]]));
    out.used = without(out.used, removal.at, removal.count);
    out.fit = removal.fit;
  }

  // A node that was taken out while others were wrong may be right after all.
  for (std::size_t r = 0; consistent && r < out.rejected.size();) {
    double residual = 0.0;
    double gate = 0.0;
    predict_rejected(data, out.rejected[r], out.fit, out.gate_sigmas, residual, gate);
    Indices more = out.used;
    static_cast<void>(more.push_back(out.rejected[r]));
    std::sort(more.begin(), more.end());
    if (std::abs(residual) <= gate) {
      const Fit trial = solver.fit(more, false);
      if (is_solution(trial) && trial.chi_square <= limit(static_cast<int>(more.size()) - unknowns)) {
        out.fit = trial;
        out.used = more;
        out.rejected.erase_at(r);
        continue;
      }
    }
    ++r;
  }
  for (std::size_t r = 0; r < out.rejected.size(); ++r) {
    predict_rejected(data, out.rejected[r], out.fit, out.gate_sigmas, out.rejected_residual[r], out.rejected_gate[r]);
  }

  if (!consistent && (is_solution(out.fit) || out.fit.status == SolveStatus::kRankDeficient)) {
    out.status = FixStatus::kInconsistent;
  } else if (out.fit.status == SolveStatus::kConverged) {
    out.status = FixStatus::kConverged;
  } else if (out.fit.status == SolveStatus::kAmbiguous) {
    out.status = FixStatus::kAmbiguous;
  } else if (out.fit.status == SolveStatus::kRankDeficient) {
    out.status = FixStatus::kRankDeficient;
  } else {
    out.status = FixStatus::kNotConverged;
  }
  return out;
}

void check_arguments(std::span<const Node> nodes, std::span<const double> toas_s, std::span<const double> sigmas_s) {
  const auto count = [](std::size_t n) { return std::to_string(n); };
  if (nodes.size() > kMaxNodes) {
    throw std::invalid_argument("nodes: " + count(nodes.size()) + " given; at most " + count(kMaxNodes) + " are taken");
  }
  if (toas_s.size() != nodes.size()) {
    throw std::invalid_argument("toas_s: " + count(toas_s.size()) + " values for " + count(nodes.size()) +
                                " nodes; one for each is expected");
  }
  if (sigmas_s.size() != nodes.size()) {
    throw std::invalid_argument("sigmas_s: " + count(sigmas_s.size()) + " values for " + count(nodes.size()) +
                                " nodes; one for each is expected");
  }
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const std::string name = "nodes[" + count(i) + "].";
    if (!nodes[i].position_m.allFinite()) throw std::invalid_argument(name + "position_m: it must be finite");
    if (!std::isfinite(nodes[i].clock_offset_s))
      throw std::invalid_argument(name + "clock_offset_s: it must be finite");
    if (!(nodes[i].sigma_s >= 0.0) || !std::isfinite(nodes[i].sigma_s)) {
      throw std::invalid_argument(name + "sigma_s: " + std::to_string(nodes[i].sigma_s) +
                                  "; it must be zero or positive, and finite");
    }
  }
}

void write_fix(const Data& data, const Outcome& outcome, const PositionFixOptions& options, bool planar,
               PositionFix& fix) {
  const Fit& fit = outcome.fit;
  fix.status = outcome.status;
  fix.dimensions = planar ? 2 : 3;
  fix.nodes_in_line = !outcome.used.empty() && in_line(data, outcome.used, planar);
  if (outcome.status == FixStatus::kTooFewNodes) return;
  const auto clock_s = [&](double clock_m) {
    return wrapped(data.reference_s + clock_m / kSpeedOfLightMps, options.period_s);
  };
  fix.position_m = fit.position + data.origin;
  fix.clock_bias_s = clock_s(fit.clock);
  fix.dop = fit.dop;
  fix.chi_square = fit.chi_square;
  fix.degrees_of_freedom = static_cast<int>(outcome.used.size()) - (planar ? 3 : 4);
  fix.chi_square_limit =
      chi_square_upper_quantile(options.false_alarm_probability, std::max(fix.degrees_of_freedom, 1));
  if (fit.unobservable.cols() == 0) {
    fix.covariance_m2 = fit.covariance.topLeftCorner<3, 3>();
    fix.clock_sigma_s = std::sqrt(fit.covariance(3, 3)) / kSpeedOfLightMps;
  }
  fix.unobservable_basis = fit.unobservable;
  fix.alternatives_m.resize(3, fit.alternatives.cols());
  fix.alternative_clock_biases_s.resize(fit.alternatives.cols());
  for (Eigen::Index i = 0; i < fit.alternatives.cols(); ++i) {
    fix.alternatives_m.col(i) = fit.alternatives.col(i).head<3>() + data.origin;
    fix.alternative_clock_biases_s[i] = clock_s(fit.alternatives(3, i));
  }
  for (std::size_t k = 0; k < outcome.used.size(); ++k) {
    const std::size_t i = outcome.used[k];
    fix.residuals_m[i] = fit.residual[k];
    constexpr double kControlled = 1e-9;
    if (fit.redundancy[k] > kControlled)
      fix.gates_m[i] = outcome.gate_sigmas * data.sigma[i] * std::sqrt(fit.redundancy[k]);
  }
  fix.suspects = outcome.suspects;
  for (std::size_t k = 0; k < outcome.rejected.size(); ++k) {
    const std::size_t i = outcome.rejected[k];
    fix.use[i] = NodeUse::kRejected;
    fix.residuals_m[i] = outcome.rejected_residual[k];
    fix.gates_m[i] = outcome.rejected_gate[k];
  }
}

template <class... Numbers>
std::string format(const char* pattern, Numbers... numbers) {
  std::array<char, 256> text{};
  std::snprintf(text.data(), text.size(), pattern, numbers...);
  return text.data();
}

std::string place(const Eigen::Vector3d& p, int dimensions) {
  return dimensions == 2 ? format("(%.1f, %.1f) m", p[0], p[1]) : format("(%.1f, %.1f, %.1f) m", p[0], p[1], p[2]);
}

std::string join(const std::vector<std::string>& texts) {
  std::string all;
  for (const std::string& text : texts) all += (all.empty() ? "" : "; ") + text;
  return all;
}

}  // namespace

std::string_view to_string(FixStatus status) noexcept {
  switch (status) {
    case FixStatus::kConverged:
      return "converged";
    case FixStatus::kAmbiguous:
      return "ambiguous";
    case FixStatus::kInconsistent:
      return "inconsistent";
    case FixStatus::kTooFewNodes:
      return "too few nodes";
    case FixStatus::kRankDeficient:
      return "rank deficient";
    case FixStatus::kNotConverged:
      return "not converged";
  }
  return "unknown";
}

void PositionFixOptions::check() const {
  if (height_m && !std::isfinite(*height_m)) throw std::invalid_argument("height_m: it must be finite");
  if (dimension == FixDimension::kPlanar && !height_m) {
    throw std::invalid_argument("height_m: not given; a planar fix needs the receiver's height");
  }
  if (near_m && !near_m->allFinite()) throw std::invalid_argument("near_m: it must be finite");
  if (!(period_s > 0.0)) throw std::invalid_argument("period_s: " + std::to_string(period_s) + "; it must be positive");
  if (!(false_alarm_probability > 0.0 && false_alarm_probability < 0.5)) {
    throw std::invalid_argument("false_alarm_probability: " + std::to_string(false_alarm_probability) +
                                "; it must lie between 0 and 0.5");
  }
  if (max_iterations < 1) {
    throw std::invalid_argument("max_iterations: " + std::to_string(max_iterations) + "; it must be at least 1");
  }
}

std::size_t PositionFix::used_count() const noexcept {
  return static_cast<std::size_t>(std::count(use.begin(), use.end(), NodeUse::kUsed));
}

std::vector<std::string> PositionFix::unobservable() const { return name_directions<Spatial>(unobservable_basis); }

namespace {

std::string outcome_text(const PositionFix& fix) {
  const std::size_t n = fix.used_count();
  const std::string nodes = std::to_string(n) + (n == 1 ? " usable node" : " usable nodes");
  const std::string kind = fix.dimensions == 2 ? "2-D" : "3-D";
  switch (fix.status) {
    case FixStatus::kTooFewNodes:
      return nodes + "; a " + kind + " position with an unknown receiver clock needs " +
             std::to_string(fix.dimensions == 2 ? 3 : 4) +
             (fix.dimensions == 3 && n == 3 ? " (3 suffice when the receiver's height is stated)" : "");
    case FixStatus::kRankDeficient:
      return "the nodes do not determine " + join(fix.unobservable()) +
             (fix.nodes_in_line ? (fix.dimensions == 2 ? ": they lie on one line" : ": they lie in one plane") : "") +
             (fix.dimensions == 3 && fix.used_count() >= 3
                  ? "; two dimensions may be had by stating the receiver's height"
                  : "");
    case FixStatus::kAmbiguous: {
      std::string text = place(fix.position_m, fix.dimensions);
      for (Eigen::Index i = 0; i < fix.alternatives_m.cols(); ++i)
        text += " and " + place(fix.alternatives_m.col(i), fix.dimensions);
      text += " fit equally well: ";
      if (fix.nodes_in_line) {
        return text + (fix.dimensions == 2 ? "the nodes lie on one line, and its two sides look alike"
                                           : "the nodes lie in one plane, and its two sides look alike");
      }
      if (fix.degrees_of_freedom > 0) return text + "the nodes do not tell them apart";
      return text + nodes + " are the minimum, and their hyperbolas meet twice";
    }
    case FixStatus::kInconsistent: {
      std::string text = "the times of arrival of " + std::to_string(n) +
                         format(" nodes disagree (chi-square %.1f, limit %.1f)", fix.chi_square, fix.chi_square_limit);
      if (!fix.suspects.empty()) {
        text += "; the node at fault may be ";
        for (std::size_t k = 0; k < fix.suspects.size(); ++k) {
          text += (k == 0 ? "" : k + 1 < fix.suspects.size() ? ", " : " or ") + std::to_string(fix.suspects[k]);
        }
      } else if (fix.degrees_of_freedom < 2) {
        text += "; with more nodes the one at fault could be told";
      }
      return text;
    }
    case FixStatus::kNotConverged:
      return "no position was found that explains the times of arrival of " + std::to_string(n) + " nodes";
    case FixStatus::kConverged:
      break;
  }
  std::string text = kind + " position from " + std::to_string(n) + " of " + std::to_string(fix.use.size()) + " nodes";
  if (fix.fell_back) text += " at the stated height, since they do not determine three dimensions";
  for (std::size_t i = 0; i < fix.use.size(); ++i) {
    if (fix.use[i] != NodeUse::kRejected) continue;
    text += format("; rejected: node %zu (residual %.3g m, gate %.3g m)", i, fix.residuals_m[i], fix.gates_m[i]);
  }
  return text;
}

}  // namespace

std::string PositionFix::message() const {
  std::string text = outcome_text(*this);
  for (std::size_t i = 0; i < use.size(); ++i) {
    const char* reason = use[i] == NodeUse::kNotFinite  ? "its time of arrival or sigma is not finite"
                         : use[i] == NodeUse::kBadSigma ? "its sigma is not positive"
                                                        : nullptr;
    if (reason != nullptr) text += "; node " + std::to_string(i) + " left out: " + reason;
  }
  return text;
}

PositionFix position_fix(std::span<const Node> nodes, std::span<const double> toas_s, std::span<const double> sigmas_s,
                         const PositionFixOptions& options) {
  options.check();
  check_arguments(nodes, toas_s, sigmas_s);
  PositionFix fix;
  const Data data = gather(nodes, toas_s, sigmas_s, options.period_s, fix);
  static_cast<void>(fix.residuals_m.resize(nodes.size(), PositionFix::kNan));
  static_cast<void>(fix.gates_m.resize(nodes.size(), PositionFix::kNan));

  const std::size_t n = data.usable.size();
  const auto height = [&]() -> std::optional<double> { return *options.height_m - data.origin[2]; };
  const bool planar = options.dimension == FixDimension::kPlanar ||
                      (options.dimension == FixDimension::kAuto && n < 4 && options.height_m);
  const Outcome first = attempt(Solver{data, options, planar ? height() : std::nullopt});
  const bool undetermined = first.status == FixStatus::kAmbiguous || first.status == FixStatus::kRankDeficient;
  if (options.dimension == FixDimension::kAuto && !planar && options.height_m && undetermined) {
    const Outcome second = attempt(Solver{data, options, height()});
    if (second.status == FixStatus::kConverged) {
      write_fix(data, second, options, true, fix);
      fix.fell_back = true;
      return fix;
    }
  }
  write_fix(data, first, options, planar, fix);
  return fix;
}

}  // namespace soopnav::navigation

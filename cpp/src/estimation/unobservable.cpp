#include "soopnav/estimation/unobservable.hpp"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <stdexcept>

namespace soopnav {
namespace {

// How much of a unit vector must lie in the span for the direction to carry its name.
constexpr double kNamed = 0.99;
constexpr double kSmallestWeight = 0.05;

std::string combination(const Eigen::VectorXd& direction, std::span<const std::string_view> names) {
  std::vector<int> order(names.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(),
                   [&](int a, int b) { return std::abs(direction[a]) > std::abs(direction[b]) + 1e-9; });
  const double sign = direction[order.front()] < 0.0 ? -1.0 : 1.0;
  std::string text;
  for (const int i : order) {
    const double weight = sign * direction[i];
    if (std::abs(weight) < kSmallestWeight) break;
    char number[16];
    std::snprintf(number, sizeof number, "%.2f ", std::abs(weight));
    if (!text.empty()) text += weight < 0.0 ? " - " : " + ";
    text += number;
    text += names[static_cast<std::size_t>(i)];
  }
  return text;
}

}  // namespace

std::vector<std::string> name_directions(const Eigen::Ref<const Eigen::MatrixXd>& basis,
                                         std::span<const std::string_view> names) {
  if (basis.rows() != static_cast<Eigen::Index>(names.size())) {
    throw std::invalid_argument("basis: " + std::to_string(basis.rows()) + " rows; one for each of the " +
                                std::to_string(names.size()) + " names expected");
  }
  std::vector<std::string> texts;
  Eigen::MatrixXd rest = basis;
  for (Eigen::Index i = 0; i < basis.rows() && rest.cols() > 0; ++i) {
    if (rest.row(i).norm() < kNamed) continue;
    texts.emplace_back(names[static_cast<std::size_t>(i)]);
    // What remains: the part of the span at right angles to the direction named.
    const Eigen::VectorXd along = rest.row(i).transpose().normalized();
    const Eigen::MatrixXd q = Eigen::HouseholderQR<Eigen::MatrixXd>(along).householderQ();
    rest = (rest * q.rightCols(rest.cols() - 1)).eval();
  }
  for (Eigen::Index k = 0; k < rest.cols(); ++k) texts.push_back(combination(rest.col(k), names));
  return texts;
}

}  // namespace soopnav

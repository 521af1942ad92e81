#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "soopnav/estimation/state.hpp"

namespace soopnav {

/// Names the directions that the columns of `basis` span, one text for each.
///
/// `basis`: (components, count), orthonormal columns. `names`: what the components are called. A component that lies in
/// the span is named by itself ("up"); what remains is a combination with its two-digit weights, largest first
/// ("0.71 east - 0.71 north"), weights below 0.05 left out. Allocates.
[[nodiscard]] std::vector<std::string> name_directions(const Eigen::Ref<const Eigen::MatrixXd>& basis,
                                                       std::span<const std::string_view> names);

/// The same with the names of `State`.
template <FixedStateType State>
[[nodiscard]] std::vector<std::string> name_directions(const Eigen::Ref<const Eigen::MatrixXd>& basis) {
  std::array<std::string_view, static_cast<std::size_t>(State::kDim)> names;
  for (int i = 0; i < State::kDim; ++i) names[static_cast<std::size_t>(i)] = State::component_name(i);
  return name_directions(basis, names);
}

}  // namespace soopnav

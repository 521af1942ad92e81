#pragma once

#include <tuple>
#include <utility>

#include "soopnav/core/role.hpp"

namespace soopnav {

/// Several measurement models as one, rows one behind the other: observations whose errors are correlated, taken in
/// with one full R.
///
/// `Stacked{Range{q}, Doppler{...}}` has the rows of the first, then those of the second. Each model's Jacobian and
/// angular residuals stay its own; undefined where any of them is. For many models of one type see `Correlated`. Models
/// of different frames do not go together. No allocation.
template <class... Models>
struct Stacked {
  static_assert(sizeof...(Models) >= 1, "at least one model");
  static constexpr int kDim = (Models::kDim + ...);

  explicit Stacked(const Models&... m) : models(m...) {}
  std::tuple<Models...> models;

  template <class X, class Y>
  requires(FrameCompatible<Models, X>&&...) [[nodiscard]] bool predict(const X& x, Y& y) const {
    return predict_all(x, y, std::index_sequence_for<Models...>{});
  }

  /// The residual of the model that row belongs to.
  template <class T>
  [[nodiscard]] static T residual(int row, const T& z, const T& predicted) {
    T result = z - predicted;
    int first = 0;
    const auto take = [&]<class Model>(const Model*) {
      if constexpr (requires { Model::residual(row, z, predicted); }) {
        if (row >= first && row < first + Model::kDim) result = Model::residual(row - first, z, predicted);
      }
      first += Model::kDim;
    };
    (take(static_cast<const Models*>(nullptr)), ...);
    return result;
  }

 private:
  // The rows of one model.
  template <int First, int Count, class Y>
  struct Rows {
    static constexpr bool kJacobian = Y::kJacobian;
    Y& y;
    [[nodiscard]] decltype(auto) value(int i) { return y.value(First + i); }
    template <class Part>
    [[nodiscard]] auto jacobian(const Part& part) {
      return y.jacobian(part).template middleRows<Count>(First);
    }
  };
  template <std::size_t I>
  static constexpr int first_row() {
    constexpr int kRows[] = {Models::kDim...};
    int first = 0;
    for (std::size_t k = 0; k < I; ++k) first += kRows[k];
    return first;
  }
  template <class X, class Y, std::size_t... I>
  [[nodiscard]] bool predict_all(const X& x, Y& y, std::index_sequence<I...>) const {
    bool defined = true;
    const auto ask = [&](const auto& model, auto rows) { defined = model.predict(x, rows) && defined; };
    (ask(std::get<I>(models), Rows<first_row<I>(), Models::kDim, Y>{y}), ...);
    return defined;
  }
};

}  // namespace soopnav

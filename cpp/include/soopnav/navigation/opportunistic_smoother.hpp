#pragma once

#include <span>
#include <string>
#include <vector>

namespace soopnav::navigation {

/// A run of an `OpportunisticNavigator` given all its observables: fixed-interval smoothing over a state whose size
/// changes (doc/opportunistic_navigation.md section 5; pesyna IV-E).
///
/// A component that joins has no past, one that leaves keeps what later epochs still say of it. Components are numbered
/// over the whole run: those of the receiver first, then of each source in the order of joining; one that is not
/// present at an epoch is NaN there. Units as in the navigator: metres, m/s, cycles.
class OpportunisticSmoother {
 public:
  [[nodiscard]] int epochs() const noexcept { return static_cast<int>(t_s_.size()); }
  [[nodiscard]] std::span<const double> t_s() const noexcept { return t_s_; }
  /// All components that were ever present.
  [[nodiscard]] const std::vector<std::string>& component_names() const noexcept { return names_; }
  /// The source that each component belongs to; -1: the receiver.
  [[nodiscard]] const std::vector<int>& component_sources() const noexcept { return sources_; }

  /// epochs x components, row-major.
  [[nodiscard]] std::vector<double> mean() const;
  [[nodiscard]] std::vector<double> sigma() const;
  /// Covariance of some components at each epoch: epochs x k x k. @throws std::invalid_argument for a component out of
  /// range.
  [[nodiscard]] std::vector<double> covariance(std::span<const int> components) const;
  /// Covariance of one component's error with the same component's `lag` epochs later, lag 0 ... `max_lag`:
  /// cov(e_k, e_k+m) = G_k ... G_k+m-1 P_k+m, given the whole run. epochs x (max_lag + 1), NaN past the end. O(epochs
  /// max_lag n²). @throws std::invalid_argument without gains or for a component out of range.
  [[nodiscard]] std::vector<double> lag_covariance(int component, int max_lag) const;

 private:
  friend class OpportunisticNavigator;
  OpportunisticSmoother() = default;

  struct Epoch {
    std::size_t mean = 0;        // into numbers_
    std::size_t covariance = 0;  // n x n, column-major
    std::size_t gain = 0;        // n x (n of the next epoch)
    std::size_t members = 0;     // into members_
    int n = 0;
  };
  // Place of a component at an epoch, -1 when absent.
  [[nodiscard]] int place(const Epoch& epoch, int component) const noexcept;

  std::vector<double> t_s_;
  std::vector<std::string> names_;
  std::vector<int> sources_;
  std::vector<Epoch> epochs_;
  std::vector<double> numbers_;
  std::vector<int> members_;  // global component of each place
  bool gains_ = false;
};

}  // namespace soopnav::navigation

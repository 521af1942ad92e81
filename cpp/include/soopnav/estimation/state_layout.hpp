#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "soopnav/core/angle.hpp"
#include "soopnav/core/role.hpp"
#include "soopnav/estimation/state.hpp"

namespace soopnav {

/// How the components of a block add.
enum class BlockKind : std::uint8_t {
  kVector,  ///< plainly
  kAngle,   ///< each one the short way round, kept in [-pi, pi)
};

/// Which named blocks a state holds at run time, and where: blocks join behind those present, and close ranks when one
/// leaves. Bounded: the storage is made in the constructor, and nothing is allocated afterwards.
///
/// A block is named by its `Block` handle: a slot and the generation of its tenant. A handle whose block has left is
/// stale, is recognised whoever took the slot since, and is refused.
class StateLayout {
 public:
  static constexpr int kMaxNameLength = 31;

  /// Room for `max_dim` components in at most `max_blocks` blocks behind `first_dim` fixed components. Throws
  /// std::invalid_argument when a number is negative or `max_dim` < `first_dim`.
  StateLayout(int first_dim, int max_dim, int max_blocks);

  [[nodiscard]] int dim() const noexcept { return dim_; }  ///< components present, the fixed ones included
  [[nodiscard]] int first_dim() const noexcept { return first_dim_; }
  [[nodiscard]] int max_dim() const noexcept { return max_dim_; }
  [[nodiscard]] int blocks() const noexcept { return blocks_; }  ///< blocks present

  /// Whether a block of `Dim` components may still join.
  [[nodiscard]] bool has_room(int block_dim) const noexcept { return !free_.empty() && dim_ + block_dim <= max_dim_; }
  /// Adds a block at the end. A handle that names nothing when there is no room. Names are cut at `kMaxNameLength`.
  template <int Dim>
  [[nodiscard]] Block<Dim> add(std::string_view name, BlockKind kind = BlockKind::kVector) noexcept {
    const int slot = take(Dim, name, kind);
    return slot < 0 ? Block<Dim>{} : Block<Dim>{slot, slots_[static_cast<std::size_t>(slot)].generation};
  }
  /// Removes a block; those behind move up by its size. False for a stale handle.
  template <int Dim>
  bool remove(const Block<Dim>& block) noexcept {
    if (!holds(block)) return false;
    release(block.slot);
    return true;
  }
  template <int Dim>
  [[nodiscard]] bool holds(const Block<Dim>& block) const noexcept {
    if (block.slot < 0 || block.slot >= static_cast<int>(slots_.size())) return false;
    const Slot& slot = slots_[static_cast<std::size_t>(block.slot)];
    return slot.dim == Dim && slot.generation == block.generation;
  }
  /// First component of a block that `holds` says is present.
  template <int Dim>
  [[nodiscard]] int offset(const Block<Dim>& block) const noexcept {
    return slots_[static_cast<std::size_t>(block.slot)].offset;
  }
  [[nodiscard]] BlockKind kind(int slot) const noexcept { return slots_[static_cast<std::size_t>(slot)].kind; }
  /// Whether component `i` is an angle of a block.
  [[nodiscard]] bool is_angle(int i) const noexcept { return angle_[static_cast<std::size_t>(i)]; }
  /// "clock of 301" or, of a block with several components, "clock of 301 [1]"; for a component behind the fixed ones.
  /// Allocates.
  [[nodiscard]] std::string component_name(int i) const;

 private:
  struct Slot {
    int offset = 0;
    int dim = 0;  // 0: free
    std::uint32_t generation = 0;
    BlockKind kind = BlockKind::kVector;
    char name[kMaxNameLength + 1] = {};
  };
  [[nodiscard]] int take(int dim, std::string_view name, BlockKind kind) noexcept;
  void release(int slot) noexcept;

  int first_dim_;
  int max_dim_;
  int dim_;
  int blocks_ = 0;
  std::vector<Slot> slots_;
  std::vector<int> free_;    // capacity: all slots
  std::vector<bool> angle_;  // of each component
};

/// A state of fixed `Roles` followed by named blocks that join and leave at run time (the clock of source k, the
/// position of an emitter). Copying allocates; nothing else does after construction.
///
/// The fixed roles are vectors or headings. `x(block)` of a stale handle reads zeros and raises `stale()`; the filter
/// then refuses the update.
template <class FrameTag, RoleType... Roles>
class LayoutState {
 public:
  using Frame = FrameTag;
  using Fixed = ComposedState<FrameTag, Roles...>;
  static constexpr int kFixed = Fixed::kDim;
  static_assert(Fixed::kSize == Fixed::kDim, "attitudes have a place in fixed states only");

  /// Throws std::invalid_argument unless `max_dim` >= the fixed components and `max_blocks` >= 0.
  LayoutState(const Fixed& x0, int max_dim, int max_blocks)
      : layout_(kFixed, max_dim, max_blocks), x_(Eigen::VectorXd::Zero(max_dim)) {
    x_.head<kFixed>() = x0.x;
  }

  [[nodiscard]] int dim() const noexcept { return layout_.dim(); }
  [[nodiscard]] const StateLayout& layout() const noexcept { return layout_; }
  /// The components present: the fixed roles, then the blocks in the order of their joining.
  [[nodiscard]] auto x() const noexcept { return x_.head(dim()); }

  template <class R>
  requires HoldsRole<Fixed, R>
  [[nodiscard]] static constexpr int at(R role) noexcept { return Fixed::at(role); }

  template <int Dim, class Tag>
  requires HoldsRole<Fixed, Role<Dim, Tag>>
  [[nodiscard]] auto operator()(Role<Dim, Tag> role) const noexcept {
    return Eigen::Map<const Eigen::Matrix<double, Dim, 1>>(x_.data() + Fixed::at(role));
  }
  template <int Dim>
  [[nodiscard]] auto operator()(const Block<Dim>& block) const noexcept {
    const bool held = layout_.holds(block);
    stale_ = stale_ || !held;
    return Eigen::Map<const Eigen::Matrix<double, Dim, 1>>(held ? x_.data() + layout_.offset(block) : zeros_<Dim>());
  }
  template <int Dim>
  [[nodiscard]] const Known<Dim>& operator()(const Known<Dim>& known) const noexcept {
    return known;
  }

  /// Whether a stale handle was read since the last call.
  [[nodiscard]] bool take_stale() const noexcept {
    const bool was = stale_;
    stale_ = false;
    return was;
  }

  /// What component `i` is called. Allocates.
  [[nodiscard]] std::string component_name(int i) const {
    return i < kFixed ? std::string(Fixed::component_name(i)) : layout_.component_name(i);
  }

  /// Whether component `i` adds the short way round.
  [[nodiscard]] bool is_angle(int i) const noexcept {
    return i < kFixed ? kFixedAngles[static_cast<std::size_t>(i)] : layout_.is_angle(i);
  }

  // For the filter: adds a tangent, and lets blocks join and leave. The covariance is the filter's.
  template <class Step>
  void move(const Step& step) noexcept {
    for (int i = 0; i < dim(); ++i) set(i, x_[i] + step[i]);
  }
  void set(int i, double value) noexcept {
    x_[i] = is_angle(i) && !(std::abs(value) < kPi) ? wrap_to_pi(value) : value;
  }
  template <int Dim>
  [[nodiscard]] Block<Dim> add(const Eigen::Matrix<double, Dim, 1>& mean, std::string_view name,
                               BlockKind kind) noexcept {
    const int first = dim();
    const Block<Dim> block = layout_.template add<Dim>(name, kind);
    if (layout_.holds(block)) {
      for (int i = 0; i < Dim; ++i) set(first + i, mean[i]);
    }
    return block;
  }
  template <int Dim>
  bool remove(const Block<Dim>& block) noexcept {
    if (!layout_.holds(block)) return false;
    const int first = layout_.offset(block);
    for (int i = first; i + Dim < dim(); ++i) x_[i] = x_[i + Dim];
    return layout_.remove(block);
  }

 private:
  template <int Dim>
  [[nodiscard]] static const double* zeros_() noexcept {
    static constexpr std::array<double, static_cast<std::size_t>(Dim)> kZeros{};
    return kZeros.data();
  }
  static constexpr auto kFixedAngles = [] {
    std::array<bool, static_cast<std::size_t>(kFixed)> angle{};
    const auto mark = [&angle]<int Dim, class Tag>(Role<Dim, Tag> role) {
      if (detail::kIsAngle<Tag>) angle[static_cast<std::size_t>(Fixed::at(role))] = true;
    };
    (mark(Roles{}), ...);
    return angle;
  }();

  StateLayout layout_;
  Eigen::VectorXd x_;
  mutable bool stale_ = false;
};

}  // namespace soopnav

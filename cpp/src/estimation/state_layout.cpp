#include "soopnav/estimation/state_layout.hpp"

#include <algorithm>
#include <stdexcept>
#include <string>

namespace soopnav {

StateLayout::StateLayout(int first_dim, int max_dim, int max_blocks)
    : first_dim_(first_dim), max_dim_(max_dim), dim_(first_dim) {
  const auto refuse = [](const char* what, int value, const std::string& rule) {
    throw std::invalid_argument(std::string(what) + ": " + std::to_string(value) + ", " + rule);
  };
  if (first_dim < 0) refuse("first_dim", first_dim, "at least 0 expected");
  if (max_dim < first_dim) refuse("max_dim", max_dim, "at least the " + std::to_string(first_dim) + " fixed ones");
  if (max_blocks < 0) refuse("max_blocks", max_blocks, "at least 0 expected");
  slots_.resize(static_cast<std::size_t>(max_blocks));
  free_.reserve(slots_.size());
  for (int slot = max_blocks - 1; slot >= 0; --slot) free_.push_back(slot);
  angle_.resize(static_cast<std::size_t>(max_dim), false);
}

int StateLayout::take(int dim, std::string_view name, BlockKind kind) noexcept {
  if (!has_room(dim)) return -1;
  const int index = free_.back();
  free_.pop_back();
  Slot& slot = slots_[static_cast<std::size_t>(index)];
  slot.offset = dim_;
  slot.dim = dim;
  slot.kind = kind;
  ++slot.generation;  // the first tenant has 1: a handle of zeros names nothing
  const std::size_t length = std::min(name.size(), static_cast<std::size_t>(kMaxNameLength));
  std::copy_n(name.data(), length, slot.name);
  slot.name[length] = '\0';
  for (int i = 0; i < dim; ++i) angle_[static_cast<std::size_t>(dim_ + i)] = kind == BlockKind::kAngle;
  dim_ += dim;
  ++blocks_;
  return index;
}

void StateLayout::release(int slot) noexcept {
  Slot& leaving = slots_[static_cast<std::size_t>(slot)];
  const int gap = leaving.dim;
  for (int i = leaving.offset; i + gap < dim_; ++i) {
    angle_[static_cast<std::size_t>(i)] = angle_[static_cast<std::size_t>(i + gap)];
  }
  for (Slot& other : slots_) {
    if (other.dim > 0 && other.offset > leaving.offset) other.offset -= gap;
  }
  leaving.dim = 0;
  dim_ -= gap;
  --blocks_;
  free_.push_back(slot);
}

std::string StateLayout::component_name(int i) const {
  for (const Slot& slot : slots_) {
    if (slot.dim > 0 && i >= slot.offset && i < slot.offset + slot.dim) {
      return slot.dim == 1 ? std::string(slot.name)
                           : std::string(slot.name) + " [" + std::to_string(i - slot.offset) + "]";
    }
  }
  return "component " + std::to_string(i);
}

}  // namespace soopnav

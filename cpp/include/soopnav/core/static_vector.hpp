#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <type_traits>

namespace soopnav {

/// A vector of at most `Capacity` elements that lives where it is declared and never allocates.
///
/// Elements are plain values (trivially copyable, default-made at construction), so the vector itself is trivially
/// copyable. It is a contiguous range and converts to `std::span`. Indices are not checked.
template <class T, std::size_t Capacity>
class StaticVector {
  static_assert(std::is_trivially_copyable_v<T>, "StaticVector holds trivially copyable values");
  static_assert(Capacity >= 1, "StaticVector needs room for one element");

 public:
  using value_type = T;
  using size_type = std::size_t;
  using iterator = T*;
  using const_iterator = const T*;

  constexpr StaticVector() noexcept = default;

  /// Adds `value` at the end; false, and nothing changed, when the vector is full.
  [[nodiscard]] constexpr bool push_back(const T& value) noexcept {
    if (size_ == Capacity) return false;
    items_[size_++] = value;
    return true;
  }

  /// Sets the size, new elements being `value`; false, and nothing changed, when `size` is above the capacity.
  [[nodiscard]] constexpr bool resize(size_type size, const T& value = T{}) noexcept {
    if (size > Capacity) return false;
    for (size_type i = size_; i < size; ++i) items_[i] = value;
    size_ = size;
    return true;
  }

  /// Takes out the element at `index` < size(), keeping the order of the others.
  constexpr void erase_at(size_type index) noexcept {
    std::copy(begin() + index + 1, end(), begin() + index);
    --size_;
  }

  /// Drops the last element of a vector that is not empty.
  constexpr void pop_back() noexcept { --size_; }
  constexpr void clear() noexcept { size_ = 0; }

  [[nodiscard]] constexpr T& operator[](size_type i) noexcept { return items_[i]; }
  [[nodiscard]] constexpr const T& operator[](size_type i) const noexcept { return items_[i]; }
  [[nodiscard]] constexpr T& front() noexcept { return items_[0]; }
  [[nodiscard]] constexpr const T& front() const noexcept { return items_[0]; }
  [[nodiscard]] constexpr T& back() noexcept { return items_[size_ - 1]; }
  [[nodiscard]] constexpr const T& back() const noexcept { return items_[size_ - 1]; }
  [[nodiscard]] constexpr T* data() noexcept { return items_.data(); }
  [[nodiscard]] constexpr const T* data() const noexcept { return items_.data(); }
  [[nodiscard]] constexpr iterator begin() noexcept { return items_.data(); }
  [[nodiscard]] constexpr iterator end() noexcept { return items_.data() + size_; }
  [[nodiscard]] constexpr const_iterator begin() const noexcept { return items_.data(); }
  [[nodiscard]] constexpr const_iterator end() const noexcept { return items_.data() + size_; }
  [[nodiscard]] constexpr size_type size() const noexcept { return size_; }
  [[nodiscard]] static constexpr size_type capacity() noexcept { return Capacity; }
  [[nodiscard]] constexpr bool empty() const noexcept { return size_ == 0; }
  [[nodiscard]] constexpr bool full() const noexcept { return size_ == Capacity; }

  /// Same size and equal elements; what lies beyond the size does not count.
  friend constexpr bool operator==(const StaticVector& a, const StaticVector& b) noexcept {
    return std::equal(a.begin(), a.end(), b.begin(), b.end());
  }

 private:
  std::array<T, Capacity> items_{};
  size_type size_ = 0;
};

}  // namespace soopnav

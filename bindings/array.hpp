#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cstddef>
#include <initializer_list>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "soopnav/core/iq.hpp"

/// The only converter between NumPy arrays and the engine's spans.
namespace soopnav::python {

namespace py = pybind11;

/// A parameter's name as a template argument, so that a refusal can say which array it is about.
template <std::size_t N>
struct Name {
  char text[N]{};
  consteval Name(const char (&name)[N]) { std::copy_n(name, N, text); }  // NOLINT(google-explicit-constructor)
};

/// Samples of a NumPy array: complex64, one dimension, C-contiguous. Never a copy; keeps the array alive.
class IqArrayBase {
 public:
  [[nodiscard]] IqSpan span() const noexcept { return span_; }

 protected:
  IqArrayBase() = default;
  IqArrayBase(py::handle object, const char* name);

 private:
  py::object owner_;
  IqSpan span_;
};

/// Numbers of an array: float64, one dimension. Any array-like: small inputs, which may be copied.
class RealArrayBase {
 public:
  [[nodiscard]] std::span<const double> span() const noexcept { return span_; }
  [[nodiscard]] std::size_t size() const noexcept { return span_.size(); }
  [[nodiscard]] double operator[](std::size_t i) const noexcept { return span_[i]; }

 protected:
  RealArrayBase() = default;
  RealArrayBase(py::handle object, const char* name);

 private:
  py::object owner_;
  std::span<const double> span_;
};

/// Rows of numbers, such as positions: float64, two dimensions. Any array-like.
class TableBase {
 public:
  [[nodiscard]] std::size_t rows() const noexcept { return rows_; }
  [[nodiscard]] std::size_t columns() const noexcept { return columns_; }
  [[nodiscard]] std::span<const double> row(std::size_t i) const noexcept {
    return values_.subspan(i * columns_, columns_);
  }

 protected:
  TableBase() = default;
  TableBase(py::handle object, const char* name);

 private:
  py::object owner_;
  std::span<const double> values_;
  std::size_t rows_ = 0;
  std::size_t columns_ = 0;
};

/// Numbers of an array of any shape: float64. Any array-like; what fits already is not copied.
class NumbersBase {
 public:
  [[nodiscard]] std::span<const double> span() const noexcept { return span_; }
  [[nodiscard]] const std::vector<py::ssize_t>& shape() const noexcept { return shape_; }
  /// `axes` axes, otherwise throws ValueError: "<name>: expected <expected>, got float64 (3,)".
  void require_axes(std::initializer_list<std::size_t> axes, const char* expected) const;

 protected:
  NumbersBase() = default;
  NumbersBase(py::handle object, const char* name);

 private:
  py::object owner_;
  const char* name_ = "";
  std::span<const double> span_;
  std::vector<py::ssize_t> shape_;
};

/// What a bound function takes: `const IqArray<"iq">&`. Anything that does not fit raises ValueError with a sentence
/// that starts with the name.
template <Name ArgumentName>
struct IqArray : IqArrayBase {
  IqArray() = default;
  explicit IqArray(py::handle object) : IqArrayBase(object, ArgumentName.text) {}
};
template <Name ArgumentName>
struct RealArray : RealArrayBase {
  RealArray() = default;
  explicit RealArray(py::handle object) : RealArrayBase(object, ArgumentName.text) {}
};
template <Name ArgumentName>
struct Table : TableBase {
  Table() = default;
  explicit Table(py::handle object) : TableBase(object, ArgumentName.text) {}
};
template <Name ArgumentName>
struct Numbers : NumbersBase {
  Numbers() = default;
  explicit Numbers(py::handle object) : NumbersBase(object, ArgumentName.text) {}
};

/// Hands a vector to NumPy without a copy: the array owns it. `shape` must multiply to its size; empty means (size,).
template <class T>
py::array_t<T> to_array(std::vector<T>&& values, std::vector<py::ssize_t> shape = {}) {
  auto owned = std::make_unique<std::vector<T>>(std::move(values));
  if (shape.empty()) shape.push_back(static_cast<py::ssize_t>(owned->size()));
  T* const data = owned->data();
  const py::capsule owner(owned.get(), [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  static_cast<void>(owned.release());
  return py::array_t<T>(std::move(shape), data, owner);
}

/// A read-only array over numbers that `owner` (a bound object) keeps.
template <class T>
py::array_t<T> view_array(std::span<const T> values, py::handle owner, std::vector<py::ssize_t> shape = {}) {
  if (shape.empty()) shape.push_back(static_cast<py::ssize_t>(values.size()));
  py::array_t<T> array(std::move(shape), values.data(), owner);
  array.attr("setflags")(py::arg("write") = false);
  return array;
}

/// "complex128 (4000,)": dtype and shape of an array, or the type of another object.
std::string describe(py::handle object);

/// 4800 -> "4 800".
std::string grouped(std::size_t number);

/// The first sample that is NaN or infinite.
std::optional<std::size_t> first_non_finite(IqSpan iq) noexcept;

}  // namespace soopnav::python

namespace pybind11::detail {

template <soopnav::python::Name ArgumentName>
struct type_caster<soopnav::python::Numbers<ArgumentName>> {
  PYBIND11_TYPE_CASTER(soopnav::python::Numbers<ArgumentName>, const_name("numpy.typing.ArrayLike"));
  bool load(handle source, bool) {
    value = soopnav::python::Numbers<ArgumentName>(source);
    return true;
  }
};

template <soopnav::python::Name ArgumentName>
struct type_caster<soopnav::python::IqArray<ArgumentName>> {
  PYBIND11_TYPE_CASTER(soopnav::python::IqArray<ArgumentName>, const_name("numpy.typing.NDArray[numpy.complex64]"));
  bool load(handle source, bool) {
    value = soopnav::python::IqArray<ArgumentName>(source);
    return true;
  }
};

template <soopnav::python::Name ArgumentName>
struct type_caster<soopnav::python::RealArray<ArgumentName>> {
  PYBIND11_TYPE_CASTER(soopnav::python::RealArray<ArgumentName>, const_name("numpy.typing.ArrayLike"));
  bool load(handle source, bool) {
    value = soopnav::python::RealArray<ArgumentName>(source);
    return true;
  }
};

template <soopnav::python::Name ArgumentName>
struct type_caster<soopnav::python::Table<ArgumentName>> {
  PYBIND11_TYPE_CASTER(soopnav::python::Table<ArgumentName>, const_name("numpy.typing.ArrayLike"));
  bool load(handle source, bool) {
    value = soopnav::python::Table<ArgumentName>(source);
    return true;
  }
};

}  // namespace pybind11::detail

#pragma once

#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <complex>
#include <cstddef>
#include <span>
#include <string>

#include "array.hpp"

/// Arrays of several channels: samples, and matrices of complex numbers.
namespace soopnav::python {

/// Samples of several channels: complex64, shape (channels, n), C-contiguous. Never a copy; keeps the array alive.
class ChannelArrayBase {
 public:
  [[nodiscard]] const Cf32* data() const noexcept { return data_; }
  [[nodiscard]] std::size_t channels() const noexcept { return channels_; }
  [[nodiscard]] std::size_t samples() const noexcept { return samples_; }
  [[nodiscard]] IqSpan channel(std::size_t m) const noexcept { return {data_ + m * samples_, samples_}; }

 protected:
  ChannelArrayBase() = default;
  ChannelArrayBase(py::handle object, const char* name);

 private:
  py::object owner_;
  const Cf32* data_ = nullptr;
  std::size_t channels_ = 0, samples_ = 0;
};

/// A matrix of complex numbers: complex128, two dimensions, row-major. Any array-like.
class ComplexTableBase {
 public:
  [[nodiscard]] std::size_t rows() const noexcept { return rows_; }
  [[nodiscard]] std::size_t columns() const noexcept { return columns_; }
  [[nodiscard]] std::span<const std::complex<double>> values() const noexcept { return values_; }
  [[nodiscard]] const std::complex<double>& operator()(std::size_t row, std::size_t column) const noexcept {
    return values_[row * columns_ + column];
  }

 protected:
  ComplexTableBase() = default;
  ComplexTableBase(py::handle object, const char* name);

 private:
  py::object owner_;
  std::span<const std::complex<double>> values_;
  std::size_t rows_ = 0, columns_ = 0;
};

template <Name ArgumentName>
struct ChannelArray : ChannelArrayBase {
  ChannelArray() = default;
  explicit ChannelArray(py::handle object) : ChannelArrayBase(object, ArgumentName.text) {}
};
template <Name ArgumentName>
struct ComplexTable : ComplexTableBase {
  ComplexTable() = default;
  explicit ComplexTable(py::handle object) : ComplexTableBase(object, ArgumentName.text) {}
};

}  // namespace soopnav::python

namespace pybind11::detail {

template <soopnav::python::Name ArgumentName>
struct type_caster<soopnav::python::ChannelArray<ArgumentName>> {
  PYBIND11_TYPE_CASTER(soopnav::python::ChannelArray<ArgumentName>,
                       const_name("numpy.typing.NDArray[numpy.complex64]"));
  bool load(handle source, bool) {
    value = soopnav::python::ChannelArray<ArgumentName>(source);
    return true;
  }
};

template <soopnav::python::Name ArgumentName>
struct type_caster<soopnav::python::ComplexTable<ArgumentName>> {
  PYBIND11_TYPE_CASTER(soopnav::python::ComplexTable<ArgumentName>, const_name("numpy.typing.ArrayLike"));
  bool load(handle source, bool) {
    value = soopnav::python::ComplexTable<ArgumentName>(source);
    return true;
  }
};

}  // namespace pybind11::detail

#include "array.hpp"

#include <algorithm>
#include <cmath>
#include <complex>

namespace soopnav::python {

namespace {

std::string shape_text(const py::array& array) { return py::str(array.attr("shape")).cast<std::string>(); }

std::string dtype_text(const py::array& array) { return py::str(array.dtype()).cast<std::string>(); }

}  // namespace

std::string describe(py::handle object) {
  if (!py::isinstance<py::array>(object)) return py::type::of(object).attr("__name__").cast<std::string>();
  const auto array = py::reinterpret_borrow<py::array>(object);
  return dtype_text(array) + " " + shape_text(array);
}

std::string grouped(std::size_t number) {
  std::string digits = std::to_string(number);
  for (std::size_t end = digits.size(); end > 3; end -= 3) digits.insert(end - 3, 1, ' ');
  return digits;
}

std::optional<std::size_t> first_non_finite(IqSpan iq) noexcept {
  for (std::size_t i = 0; i < iq.size(); ++i) {
    if (!std::isfinite(iq[i].real()) || !std::isfinite(iq[i].imag())) return i;
  }
  return std::nullopt;
}

IqArrayBase::IqArrayBase(py::handle object, const char* name) {
  const std::string argument = name;
  const std::string expected = argument + ": expected complex64 with shape (n,), got " + describe(object);
  if (!py::isinstance<py::array>(object)) {
    throw py::value_error(expected + "; convert with np.asarray(" + argument + ", np.complex64)");
  }
  const auto array = py::reinterpret_borrow<py::array>(object);
  if (array.ndim() != 1) {
    const auto* const shape = array.shape();
    const bool one_long_axis = array.ndim() > 0 && array.size() == *std::max_element(shape, shape + array.ndim());
    throw py::value_error(expected + (one_long_axis ? "; flatten with " + argument + ".ravel()"
                                                    : "; pass one channel, such as " + argument + "[0]"));
  }
  if (!array.dtype().equal(py::dtype::of<Cf32>())) {
    throw py::value_error(expected + (array.dtype().kind() == 'c'
                                          ? "; convert with " + argument + ".astype(np.complex64)"
                                          : "; raw files are decoded by soopnav_cpp.io.read_iq"));
  }
  constexpr int kAligned = py::detail::npy_api::NPY_ARRAY_ALIGNED_;
  if ((array.flags() & py::array::c_style) == 0 || (array.flags() & kAligned) == 0) {
    throw py::value_error(expected + " with strides " + py::str(array.attr("strides")).cast<std::string>() +
                          "; copy with np.ascontiguousarray(" + argument + ")");
  }
  span_ = IqSpan(static_cast<const Cf32*>(array.data()), static_cast<std::size_t>(array.size()));
  owner_ = array;
}

namespace {

py::array_t<double, py::array::c_style | py::array::forcecast> to_reals(py::handle object, const std::string& expected,
                                                                        py::ssize_t dimensions) {
  auto array = py::array_t<double, py::array::c_style | py::array::forcecast>::ensure(object);
  if (!array) throw py::value_error(expected + ", got " + describe(object));
  if (array.ndim() != dimensions) throw py::value_error(expected + ", got " + describe(array));
  return array;
}

}  // namespace

RealArrayBase::RealArrayBase(py::handle object, const char* name) {
  const auto array = to_reals(object, std::string(name) + ": expected numbers with shape (n,)", 1);
  span_ = {array.data(), static_cast<std::size_t>(array.size())};
  owner_ = array;
}

TableBase::TableBase(py::handle object, const char* name) {
  const auto array = to_reals(object, std::string(name) + ": expected numbers with shape (n, columns)", 2);
  rows_ = static_cast<std::size_t>(array.shape(0));
  columns_ = static_cast<std::size_t>(array.shape(1));
  values_ = {array.data(), rows_ * columns_};
  owner_ = array;
}

NumbersBase::NumbersBase(py::handle object, const char* name) : name_(name) {
  const auto array = py::array_t<double, py::array::c_style | py::array::forcecast>::ensure(object);
  if (!array) throw py::value_error(std::string(name) + ": expected an array of numbers, got " + describe(object));
  span_ = {array.data(), static_cast<std::size_t>(array.size())};
  shape_.assign(array.shape(), array.shape() + array.ndim());
  owner_ = array;
}

void NumbersBase::require_axes(std::initializer_list<std::size_t> axes, const char* expected) const {
  if (std::find(axes.begin(), axes.end(), shape_.size()) != axes.end()) return;
  throw py::value_error(std::string(name_) + ": expected " + expected + ", got " + describe(owner_));
}

}  // namespace soopnav::python

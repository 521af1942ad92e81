#include "channel_arrays.hpp"

namespace soopnav::python {

ChannelArrayBase::ChannelArrayBase(py::handle object, const char* name) {
  const std::string argument = name;
  const std::string expected = argument + ": expected complex64 with shape (channels, n), got " + describe(object);
  if (!py::isinstance<py::array>(object)) {
    throw py::value_error(expected + "; convert with np.asarray(" + argument + ", np.complex64)");
  }
  const auto array = py::reinterpret_borrow<py::array>(object);
  if (array.ndim() != 2) {
    throw py::value_error(expected + (array.ndim() == 1 ? "; one channel is " + argument + "[None, :]" : ""));
  }
  if (!array.dtype().equal(py::dtype::of<Cf32>())) {
    throw py::value_error(expected + "; convert with " + argument + ".astype(np.complex64)");
  }
  constexpr int kAligned = py::detail::npy_api::NPY_ARRAY_ALIGNED_;
  if ((array.flags() & py::array::c_style) == 0 || (array.flags() & kAligned) == 0) {
    throw py::value_error(expected + " with strides " + py::str(array.attr("strides")).cast<std::string>() +
                          "; copy with np.ascontiguousarray(" + argument + ")");
  }
  data_ = static_cast<const Cf32*>(array.data());
  channels_ = static_cast<std::size_t>(array.shape(0));
  samples_ = static_cast<std::size_t>(array.shape(1));
  owner_ = array;
}

ComplexTableBase::ComplexTableBase(py::handle object, const char* name) {
  using Array = py::array_t<std::complex<double>, py::array::c_style | py::array::forcecast>;
  const std::string expected = std::string(name) + ": expected complex numbers with shape (rows, columns), got ";
  const auto array = Array::ensure(object);
  if (!array) throw py::value_error(expected + describe(object));
  if (array.ndim() != 2) throw py::value_error(expected + describe(array));
  rows_ = static_cast<std::size_t>(array.shape(0));
  columns_ = static_cast<std::size_t>(array.shape(1));
  values_ = {array.data(), rows_ * columns_};
  owner_ = array;
}

}  // namespace soopnav::python

#pragma once

#include <stdexcept>

namespace soopnav::python {

/// The cell asked for is not in the samples; Python sees CellLostError.
class CellLost : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace soopnav::python

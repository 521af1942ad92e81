// Position fixes from arbitrary numbers: refused with a sentence, or answered without a NaN where there is an answer.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "soopnav/navigation/position_fix.hpp"

namespace navigation = soopnav::navigation;

namespace {

void demand(bool condition) {
  if (!condition) std::abort();
}

/// Takes numbers from the input: bit patterns of any double, or metres of an ordinary scale.
class Numbers {
 public:
  Numbers(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {}
  [[nodiscard]] bool empty() const { return size_ < 8; }
  [[nodiscard]] double any() {
    double value = 0.0;
    if (empty()) return value;
    std::memcpy(&value, data_, 8);
    data_ += 8;
    size_ -= 8;
    return value;
  }
  [[nodiscard]] double within(double scale) {
    const double value = std::fmod(any(), 2.0);
    return std::isfinite(value) ? scale * value : 0.0;
  }

 private:
  const std::uint8_t* data_;
  std::size_t size_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2) return 0;
  const bool wild = data[0] % 4 == 0;
  navigation::PositionFixOptions options;
  options.dimension = static_cast<navigation::FixDimension>(data[0] / 4 % 3);
  if (data[0] & 64U) options.height_m = 1.5;
  if (data[0] & 128U) options.near_m = Eigen::Vector3d(10.0, 20.0, 30.0);
  options.reject_outliers = data[1] % 2 == 0;
  Numbers numbers(data + 2, size - 2);

  std::vector<navigation::Node> nodes;
  std::vector<double> toas_s, sigmas_s;
  while (!numbers.empty() && nodes.size() < 16) {
    navigation::Node node;
    for (int axis = 0; axis < 3; ++axis) node.position_m[axis] = wild ? numbers.any() : numbers.within(1e3);
    nodes.push_back(node);
    toas_s.push_back(wild ? numbers.any() : numbers.within(5e-6));
    sigmas_s.push_back(wild ? numbers.any() : 1e-9 + std::abs(numbers.within(1e-8)));
  }
  try {
    const auto fix = navigation::position_fix(nodes, toas_s, sigmas_s, options);
    demand(fix.use.size() == nodes.size() && fix.residuals_m.size() == nodes.size());
    demand(!fix.message().empty());
    if (fix.status == navigation::FixStatus::kConverged) {
      demand(fix.position_m.allFinite() && std::isfinite(fix.clock_bias_s) && fix.covariance_m2.allFinite());
      demand(fix.covariance_m2.diagonal().minCoeff() >= 0.0);
      demand(static_cast<int>(fix.used_count()) > fix.dimensions);
    }
  } catch (const std::invalid_argument&) {
    const bool finite =
        std::all_of(nodes.begin(), nodes.end(), [](const auto& node) { return node.position_m.allFinite(); });
    demand(!finite || (options.dimension == navigation::FixDimension::kPlanar && !options.height_m));
  }
  return 0;
}

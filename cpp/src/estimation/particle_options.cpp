#include "soopnav/estimation/particle_options.hpp"

#include <stdexcept>
#include <string>

namespace soopnav::detail {

void check_particle_options(const ParticleOptions& options) {
  if (options.count < 1 || options.count > 2147483647U) {
    throw std::invalid_argument("count is " + std::to_string(options.count) + "; it must be 1 ... 2147483647");
  }
  if (options.threads < 1 || options.threads > 256) {
    throw std::invalid_argument("threads is " + std::to_string(options.threads) + "; it must be 1 ... 256");
  }
  if (!(options.ess_threshold >= 0.0 && options.ess_threshold <= 1.0)) {
    throw std::invalid_argument("ess_threshold is " + std::to_string(options.ess_threshold) + "; it must be 0 ... 1");
  }
  if (to_string(options.resampling) == "unknown") {
    throw std::invalid_argument("resampling is " + std::to_string(static_cast<int>(options.resampling)) +
                                "; it must be one of the named schemes");
  }
}

}  // namespace soopnav::detail

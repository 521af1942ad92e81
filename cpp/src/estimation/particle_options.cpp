#include "soopnav/estimation/particle_options.hpp"

#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>

namespace soopnav::detail {

static void check_adaptive_count(const ParticleOptions& options);

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
  if (!(options.regularisation >= 0.0 && options.regularisation <= 2.0)) {
    throw std::invalid_argument("regularisation is " + std::to_string(options.regularisation) + "; it must be 0 ... 2");
  }
  check_adaptive_count(options);
}

void check_adaptive_count(const ParticleOptions& options) {
  const AdaptiveCount& adaptive = options.adaptive;
  if (adaptive.bin_sizes.empty()) return;
  bool any = false;
  for (std::size_t i = 0; i < adaptive.bin_sizes.size(); ++i) {
    const double size = adaptive.bin_sizes[i];
    if (!(size >= 0.0) || std::isinf(size)) {
      throw std::invalid_argument("adaptive.bin_sizes[" + std::to_string(i) + "] is " + std::to_string(size) +
                                  "; it must be 0 or a positive number");
    }
    any = any || size > 0.0;
  }
  if (!any) throw std::invalid_argument("adaptive.bin_sizes are all 0; at least one must be positive");
  if (adaptive.least < 1 || adaptive.least > options.count) {
    throw std::invalid_argument("adaptive.least is " + std::to_string(adaptive.least) +
                                "; it must be 1 ... count = " + std::to_string(options.count));
  }
  if (!(adaptive.divergence > 0.0) || std::isinf(adaptive.divergence)) {
    throw std::invalid_argument("adaptive.divergence is " + std::to_string(adaptive.divergence) +
                                "; it must be a positive number");
  }
  if (!(adaptive.probability > 0.5 && adaptive.probability < 1.0)) {
    throw std::invalid_argument("adaptive.probability is " + std::to_string(adaptive.probability) +
                                "; it must be above 0.5 and below 1");
  }
  if (options.auxiliary) throw std::invalid_argument("adaptive: not together with auxiliary");
}

}  // namespace soopnav::detail

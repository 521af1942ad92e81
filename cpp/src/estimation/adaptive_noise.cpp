#include "soopnav/estimation/adaptive_noise.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace soopnav {

namespace {

// One innovation moves log(multiplier) by no more than this: an outlier is one innovation among many.
constexpr double kLargestStep = 0.7;

[[noreturn]] void refuse(const char* name, double value, const std::string& rule) {
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + ", " + rule + " expected");
}

}  // namespace

void AdaptiveNoiseOptions::check() const {
  if (!(lower > 0.0) || std::isinf(lower)) refuse("lower", lower, "above zero");
  if (!(upper > lower) || std::isinf(upper)) refuse("upper", upper, "above lower");
  if (!(initial >= lower && initial <= upper)) refuse("initial", initial, "a value between lower and upper");
  if (!(memory >= 1.0) || std::isinf(memory)) refuse("memory", memory, "at least one");
  if (!(prior_information > 0.0) || std::isinf(prior_information)) {
    refuse("prior_information", prior_information, "above zero");
  }
}

AdaptiveProcessNoise::AdaptiveProcessNoise(const AdaptiveNoiseOptions& options) : options_(options) {
  options.check();
  keep_ = std::exp(-1.0 / options.memory);
  log_multiplier_ = std::log(options.initial);
  information_ = options.prior_information;
}

bool AdaptiveProcessNoise::learn(double score, double information) noexcept {
  if (!std::isfinite(score) || !std::isfinite(information)) return false;
  information_ = keep_ * information_ + information;
  // Eq. 33. Forgetting may leave no information at all, where nothing was ever learnt.
  if (information_ > 0.0) {
    const double step = std::clamp(score / information_, -kLargestStep, kLargestStep);
    log_multiplier_ = std::clamp(log_multiplier_ + step, std::log(options_.lower), std::log(options_.upper));
  }
  return true;
}

}  // namespace soopnav

#include "soopnav/simulation/ofdm_link.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <thread>

#include "simulation/ofdm_renderer.hpp"
#include "simulation/require.hpp"

namespace soopnav::simulation {
namespace {

constexpr int kMaxSymbols = 1 << 16;
constexpr double kMaxString = 1 << 24;
constexpr double kMaxLengthM = 1e9;
constexpr int kMaxThreads = 256;

const ofdm::Numerology& checked(const ofdm::Numerology& numerology, int symbols, const OfdmLinkOptions& options) {
  ofdm::check(numerology);
  require(symbols >= 1 && symbols <= kMaxSymbols, "symbols", symbols, "it must be 1 to 65536");
  require(options.oversampling == 1 || options.oversampling == 15, "oversampling", options.oversampling,
          "it must be 1 or 15");
  require(options.movement == Movement::kInterpolateAndShift || options.movement == Movement::kFractionalDelay,
          "movement", static_cast<double>(options.movement), "it must be one of Movement");
  require(std::isfinite(options.cfo_hz), "cfo_hz", options.cfo_hz, "it must be finite");
  const double string = (symbols + 1.0) * numerology.symbol_samples() * options.oversampling;
  require(string <= kMaxString, "symbols", symbols, "an epoch must not be longer than 16777216 samples");
  return numerology;
}

void check_path(double delay_m, const Reflection* reflection) {
  require(std::abs(delay_m) <= kMaxLengthM, "delay_m", delay_m, "it must be finite and at most 1e9 in magnitude");
  if (reflection == nullptr) return;
  require(std::abs(reflection->extra_m) <= kMaxLengthM, "reflection extra_m", reflection->extra_m,
          "it must be finite and at most 1e9 in magnitude");
  require(std::isfinite(reflection->gain.real()) && std::isfinite(reflection->gain.imag()), "reflection gain",
          std::abs(reflection->gain), "it must be finite");
}

void check_snr(const std::optional<double>& snr_db) {
  if (!snr_db) return;
  require(*snr_db >= -60.0 && *snr_db <= 100.0, "snr_db", *snr_db, "it must lie between -60 and 100");
}

}  // namespace

struct OfdmLink::Worker {
  Worker(const OfdmLink& link, ofdm::BoundaryMethod method)
      : renderer(link.numerology_, link.symbols_, link.options_),
        estimator(link.numerology_, link.symbols_, link.options_.oversampling, {method, std::nullopt}),
        iq(link.epoch_samples()) {}

  Renderer renderer;
  ofdm::BoundaryEstimator estimator;
  std::vector<Cf32> iq;
};

OfdmLink::OfdmLink(const ofdm::Numerology& numerology, int symbols, const OfdmLinkOptions& options)
    : numerology_(checked(numerology, symbols, options)),
      symbols_(symbols),
      options_(options),
      renderer_(std::make_unique<Renderer>(numerology, symbols, options)) {}
OfdmLink::~OfdmLink() = default;
OfdmLink::OfdmLink(OfdmLink&&) noexcept = default;
OfdmLink& OfdmLink::operator=(OfdmLink&&) noexcept = default;

std::size_t OfdmLink::epoch_samples() const noexcept {
  return static_cast<std::size_t>(symbols_ + 1) * static_cast<std::size_t>(numerology_.symbol_samples()) *
         static_cast<std::size_t>(options_.oversampling);
}

void OfdmLink::epoch(double delay_m, const RandomStream& random, std::span<Cf32> out, std::optional<double> snr_db,
                     const std::optional<Reflection>& reflection) {
  check_path(delay_m, reflection ? &*reflection : nullptr);
  check_snr(snr_db);
  require(out.size() == epoch_samples(), "out.size()", static_cast<double>(out.size()),
          "it must be the samples of an epoch");
  renderer_->render(delay_m, random, out, snr_db, reflection);
}

BoundarySeries OfdmLink::measure(std::span<const double> delays_m, std::span<const Reflection> reflections,
                                 const RandomStream& random, const Measure& how) {
  require(reflections.empty() || reflections.size() == delays_m.size(), "reflections.size()",
          static_cast<double>(reflections.size()), "it must be none or one per delay");
  for (std::size_t e = 0; e < delays_m.size(); ++e) {
    check_path(delays_m[e], reflections.empty() ? nullptr : &reflections[e]);
  }
  check_snr(how.snr_db);
  require(how.threads >= 1 && how.threads <= kMaxThreads, "threads", how.threads, "it must be 1 to 256");
  const std::size_t epochs = delays_m.size();
  const std::size_t crew = std::min(static_cast<std::size_t>(how.threads), std::max<std::size_t>(epochs, 1));
  if (!workers_.empty() && workers_.front()->estimator.options().method != how.method) workers_.clear();
  while (workers_.size() < crew) workers_.push_back(std::make_unique<Worker>(*this, how.method));

  BoundarySeries out;
  out.range_m.resize(epochs);
  out.sigma_m.resize(epochs);
  out.metric.resize(epochs);
  out.status.resize(epochs);
  const std::size_t width = workers_.front()->estimator.correlator().period();
  if (how.folded) out.folded.resize(epochs * width);
  std::atomic<std::size_t> next{0};
  const auto work = [&](Worker& worker) {
    for (std::size_t e = next.fetch_add(1); e < epochs; e = next.fetch_add(1)) {
      std::optional<Reflection> reflection;
      if (!reflections.empty() && reflections[e].gain != 0.0) reflection = reflections[e];
      worker.renderer.render(delays_m[e], random.substream(e), worker.iq, how.snr_db, reflection);
      const ofdm::Boundary boundary = worker.estimator.estimate(worker.iq);
      out.range_m[e] = boundary.boundary_m;
      out.sigma_m[e] = boundary.sigma_m;
      out.metric[e] = boundary.metric;
      out.status[e] = boundary.status;
      if (how.folded) worker.estimator.folded_differences(std::span(out.folded).subspan(e * width, width));
    }
  };
  std::vector<std::jthread> others;
  others.reserve(crew - 1);
  for (std::size_t t = 1; t < crew; ++t) others.emplace_back([&work, &worker = *workers_[t]] { work(worker); });
  work(*workers_.front());
  others.clear();  // joins
  return out;
}

}  // namespace soopnav::simulation

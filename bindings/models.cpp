#include "models.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <charconv>
#include <functional>
#include <initializer_list>

#include "soopnav/estimation/covariance_check.hpp"
#include "soopnav/estimation/detail/gaussian_update.hpp"

namespace soopnav::python {

namespace {

std::string shortest(double value) {
  std::array<char, 32> text{};
  const auto end = std::to_chars(text.data(), text.data() + text.size(), value).ptr;
  return {text.data(), end};
}

std::string join(const std::vector<std::string>& words, std::string_view last = ", ") {
  std::string text;
  for (std::size_t i = 0; i < words.size(); ++i) {
    if (i > 0) text += i + 1 == words.size() ? std::string(last) : ", ";
    text += words[i];
  }
  return text;
}

struct StateFacts {
  std::string_view name;
  std::size_t size;
};

const std::vector<StateFacts>& shipped() {
  static const std::vector<StateFacts> kFacts = []<class... Entries>(StateList<Entries...>) {
    return std::vector<StateFacts>{{Entries::kName, static_cast<std::size_t>(Entries::State::kSize)}...};
  }(ShippedStates{});
  return kFacts;
}

}  // namespace

std::string resolve_state(std::string_view name, std::size_t size) {
  if (name == "custom") {
    if (size >= 1 && size <= static_cast<std::size_t>(kMaxCustomDim)) return "custom";
    throw std::invalid_argument("x0: " + std::to_string(size) + " numbers; a custom state has 1 to " +
                                std::to_string(kMaxCustomDim));
  }
  std::vector<std::string> near;
  std::vector<std::string> all;
  for (const StateFacts& state : shipped()) {
    const bool stem = state.name.substr(0, state.name.size() - 1) == name && detail::is_digit(state.name.back());
    if ((state.name == name || stem) && state.size == size) return std::string(state.name);
    if (state.name == name || stem)
      near.push_back("'" + std::string(state.name) + "' has " + std::to_string(state.size));
    all.emplace_back(state.name);
  }
  if (!near.empty()) {
    throw std::invalid_argument("x0: " + std::to_string(size) + " numbers, but state " + join(near));
  }
  all.emplace_back("custom");
  throw std::invalid_argument("state: no '" + std::string(name) + "'; there are " + join(all));
}

// --- Parameters ---

const std::vector<double>* Parameters::find(std::string_view name) const noexcept {
  for (const auto& [key, numbers] : values_) {
    if (key == name) return &numbers;
  }
  return nullptr;
}

std::span<const double> Parameters::numbers(std::string_view name, std::initializer_list<std::size_t> sizes) const {
  const std::string what(name);
  const std::vector<double>* numbers = find(name);
  if (numbers == nullptr) throw std::invalid_argument(what + ": missing");
  if (std::find(sizes.begin(), sizes.end(), numbers->size()) == sizes.end()) {
    std::vector<std::string> expected;
    for (const std::size_t n : sizes) expected.push_back(std::to_string(n));
    throw std::invalid_argument(what + ": expected " + join(expected, " or ") +
                                (sizes.size() == 1 && *sizes.begin() == 1 ? " number" : " numbers") + ", got " +
                                std::to_string(numbers->size()));
  }
  for (std::size_t i = 0; i < numbers->size(); ++i) {
    if (std::isfinite((*numbers)[i])) continue;
    throw std::invalid_argument(what + (numbers->size() == 1 ? "" : "[" + std::to_string(i) + "]") + " is " +
                                shortest((*numbers)[i]) + ", not a finite number");
  }
  return *numbers;
}

double Parameters::number(std::string_view name, std::optional<double> fallback) const {
  if (fallback && !has(name)) return *fallback;
  return numbers(name, {1})[0];
}

double Parameters::positive(std::string_view name, std::optional<double> fallback) const {
  const double value = number(name, fallback);
  if (value > 0.0) return value;
  throw std::invalid_argument(std::string(name) + ": " + shortest(value) + " is not positive");
}

double Parameters::not_negative(std::string_view name, std::optional<double> fallback) const {
  const double value = number(name, fallback);
  if (value >= 0.0) return value;
  throw std::invalid_argument(std::string(name) + ": " + shortest(value) + " is negative");
}

std::string Parameters::text() const {
  std::vector<std::string> words;
  for (const auto& [name, numbers] : values_) {
    std::vector<std::string> texts;
    for (const double value : numbers) texts.push_back(shortest(value));
    const std::string all = join(texts);
    words.push_back(name + (numbers.size() == 1 ? "=" + all : "=[" + all + "]"));
  }
  return join(words);
}

// --- Measurement models ---

namespace {

template <int Dim>
MeasurementVariant make(const std::string& kind, const Parameters& p) {
  const auto vector = [&p](std::string_view name) { return p.known<Dim>(name); };
  const auto one = [&p](std::string_view name) { return p.known<1>(name); };
  const Known<Dim> source = vector("source_m");
  if (kind == "Range") return Range_<Dim>{source};
  if (kind == "RangeDifference") return RangeDifference_<Dim>{source, vector("reference_m")};
  if (kind == "Pseudorange") return Pseudorange_<Dim>{source, one("source_clock_m")};
  if (kind == "Tdoa") {
    const auto reference = vector("reference_m");
    if (p.has("receiver_clock_m")) {
      return Tdoa_<Dim, Known<1>>{source, reference, one("receiver_clock_m"), one("reference_clock_m")};
    }
    return Tdoa_<Dim, ClockBiasRole>{source, reference, {}, one("reference_clock_m")};
  }
  if (kind == "RangeRate") {
    const auto v = vector("source_velocity_mps");
    const auto drift = one("source_drift_mps");
    if (p.has("receiver_drift_mps")) return RangeRate_<Dim, Known<1>>{source, v, drift, one("receiver_drift_mps")};
    return RangeRate_<Dim, ClockDriftRole>{source, v, drift};
  }
  if (kind == "Doppler") {
    const double f = p.positive("carrier_hz");
    const auto v = vector("source_velocity_mps");
    const auto drift = one("source_drift_mps");
    if (p.has("receiver_drift_mps")) return Doppler_<Dim, Known<1>>{f, source, v, drift, one("receiver_drift_mps")};
    return Doppler_<Dim, ClockDriftRole>{f, source, v, drift};
  }
  if (kind == "Fdoa") {
    const double f = p.positive("carrier_hz");
    const auto v = vector("source_velocity_mps");
    const auto r = vector("reference_m");
    const auto vr = vector("reference_velocity_mps");
    const auto drift = one("reference_drift_mps");
    if (p.has("receiver_drift_mps")) {
      return Fdoa_<Dim, Known<1>>{f, source, v, r, vr, one("receiver_drift_mps"), drift};
    }
    return Fdoa_<Dim, ClockDriftRole>{f, source, v, r, vr, {}, drift};
  }
  if (kind == "Azimuth") {
    if (p.has("heading_rad")) return Azimuth_<Dim>{source, one("heading_rad")};
    if constexpr (Dim == 2) return RelativeAzimuth2{source};
    throw std::invalid_argument(
        "heading_rad: an azimuth relative to the state's heading needs a source_m of 2 numbers");
  }
  if (kind == "ReceivedPower") {
    return ReceivedPower_<Dim>{source, one("power_dbm"), one("exponent"), p.positive("reference_distance_m", 1.0)};
  }
  if (kind == "CarrierPhase") {
    return CarrierPhase_<Dim>{p.positive("wavelength_m"), source, one("ambiguity_cycles"), one("source_clock_m")};
  }
  if constexpr (Dim == 3) {
    if (kind == "Elevation") return Elevation<EnuFrame>{source};
    if (kind == "AzimuthElevation") return AzimuthElevation<EnuFrame>{source, one("heading_rad")};
  }
  throw std::invalid_argument("kind: no measurement model '" + kind + "'");
}

MeasurementVariant make_model(const std::string& kind, const Parameters& p) {
  for (const auto& [name, numbers] : p.values()) static_cast<void>(p.numbers(name, {1, 2, 3}));
  if (kind == "Position") {
    const double dim = p.number("dim");
    if (dim == 1.0) return PositionFix<PlanarFrame, 1>{};
    if (dim == 2.0) return PositionFix<PlanarFrame, 2>{};
    if (dim == 3.0) return PositionFix<EnuFrame, 3>{};
    throw std::invalid_argument("dim: " + shortest(dim) + " is not 1, 2 or 3");
  }
  if (kind == "PlanarIncrement") {
    static_cast<void>(p.numbers("previous_position_m", {2}));
    return PlanarIncrement<PlanarFrame>{p.known<2>("previous_position_m"), p.number("previous_heading_rad")};
  }
  const bool spatial = kind == "Elevation" || kind == "AzimuthElevation";
  const auto source = spatial ? p.numbers("source_m", {3}) : p.numbers("source_m", {2, 3});
  return source.size() == 2 ? make<2>(kind, p) : make<3>(kind, p);
}

// --- What a model reads, in words ---

template <int Dim, class Tag>
std::string describe_role(Role<Dim, Tag>) {
  if constexpr (std::same_as<Tag, PositionTag>) {
    return "a position of " + std::to_string(Dim) + (Dim == 1 ? " component" : " components");
  } else if constexpr (std::same_as<Tag, VelocityTag>) {
    return "a velocity of " + std::to_string(Dim) + " components";
  } else {
    return "a " + std::string(soopnav::detail::role_component_name<PlanarFrame>(Role<Dim, Tag>{}, 0));
  }
}

template <class Part>
void add_part(std::vector<std::string>& words) {
  if constexpr (RoleType<Part>) words.push_back(describe_role(Part{}));
}
template <template <class...> class Model, class... Parts>
std::vector<std::string> reads(const Model<Parts...>&) {
  std::vector<std::string> words;
  (add_part<Parts>(words), ...);
  return words;
}
template <class Frame, int Dim, class Part>
std::vector<std::string> reads(const PositionFix<Frame, Dim, Part>&) {
  return {describe_role(Part{})};
}

template <class Model, class... Entries>
std::vector<std::string> readers(const Model&, StateList<Entries...>) {
  std::vector<std::string> names;
  ((kCanRead<typename Entries::State, Model> ? names.emplace_back(Entries::kName) : names.emplace_back()), ...);
  std::erase(names, "");
  return names;
}

}  // namespace

AnyMeasurement::AnyMeasurement(std::string kind, Parameters parameters)
    : kind_(std::move(kind)), parameters_(std::move(parameters)), model_(make_model(kind_, parameters_)) {}

int AnyMeasurement::rows() const noexcept {
  return std::visit([]<class Model>(const Model&) { return Model::kDim; }, model_);
}

void detail::refuse_state(const AnyMeasurement& measurement, std::string_view state) {
  const auto [needs, able] = std::visit(
      [](const auto& model) { return std::pair(reads(model), readers(model, ShippedStates{})); }, measurement.model());
  throw std::invalid_argument(measurement.kind() + " reads " + join(needs, " and ") + "; state '" + std::string(state) +
                              "' has not all of that. States that have: " + join(able));
}

void require_readable(const AnyMeasurement& measurement, std::string_view state) {
  const auto able = std::visit([](const auto& model) { return readers(model, ShippedStates{}); }, measurement.model());
  if (std::find(able.begin(), able.end(), state) == able.end()) detail::refuse_state(measurement, state);
}

// --- Process models ---

namespace {

std::optional<clock::ClockNoise> clock_noise(const Parameters& p) {
  if (!p.has("clock")) return std::nullopt;
  const auto psd = p.numbers("clock", {2});
  for (std::size_t i = 0; i < 2; ++i) {
    if (psd[i] < 0.0)
      throw std::invalid_argument("clock[" + std::to_string(i) + "]: " + shortest(psd[i]) + " is negative");
  }
  return clock::ClockNoise{psd[0], psd[1]};
}

void require_densities(const Parameters& p, std::string_view name) {
  if (!p.has(name)) return;
  const auto values = p.numbers(name, {1, 2, 3, 4, 5, 6, 7, 8});
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (values[i] >= 0.0) continue;
    throw std::invalid_argument(std::string(name) + (values.size() == 1 ? "" : "[" + std::to_string(i) + "]") + ": " +
                                shortest(values[i]) + " is negative");
  }
}

}  // namespace

AnyProcess::AnyProcess(std::string kind, Parameters parameters)
    : kind_(std::move(kind)), parameters_(std::move(parameters)), clock_(clock_noise(parameters_)) {
  const Parameters& p = parameters_;
  require_densities(p, diffusion_name_);
  if (kind_ == "RandomWalk") {
    diffusion_name_ = "psd";
    static_cast<void>(p.numbers("psd", {1, 2, 3, 4, 5, 6, 7, 8}));
    require_densities(p, "psd");
  } else if (kind_ == "NearlyConstantVelocity") {
    motion_ = MotionKind::kNearlyConstantVelocity;
    per_axis_name_ = "acceleration_psd";
    static_cast<void>(p.numbers(per_axis_name_, {1, 2, 3}));
    require_densities(p, per_axis_name_);
  } else if (kind_ == "PiecewiseConstantAcceleration") {
    motion_ = MotionKind::kPiecewiseConstantAcceleration;
    per_axis_name_ = "acceleration_sigma_mps2";
    static_cast<void>(p.numbers(per_axis_name_, {1, 2, 3}));
    require_densities(p, per_axis_name_);
  } else if (kind_ == "CoordinatedTurn") {
    motion_ = MotionKind::kCoordinatedTurn;
    static_cast<void>(coordinated_turn());
  } else if (kind_ == "PlanarMechanization") {
    motion_ = MotionKind::kPlanarMechanization;
    static_cast<void>(planar_mechanization());
  } else if (kind_ == "PlanarOdometry") {
    motion_ = MotionKind::kPlanarOdometry;
    static_cast<void>(planar_odometry());
  } else {
    throw std::invalid_argument("kind: no process model '" + kind_ + "'");
  }
}

void AnyProcess::spread(const char* name, std::span<double> values) const {
  if (!parameters_.has(name)) return;
  const auto given = parameters_.numbers(name, {1, values.size()});
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = given.size() == 1 ? given[0] : given[i];
}

std::vector<double> AnyProcess::diffusion_sigma(int size) const {
  std::vector<double> sigma(static_cast<std::size_t>(size));
  spread(diffusion_name_, sigma);
  for (double& value : sigma) value = std::sqrt(value);
  return sigma;
}

CoordinatedTurn<> AnyProcess::coordinated_turn() const {
  return {.acceleration_psd = parameters_.not_negative("acceleration_psd"),
          .turn_rate_psd = parameters_.not_negative("turn_rate_psd")};
}

inertial::PlanarMechanization AnyProcess::planar_mechanization() const {
  const bool euler = parameters_.number("euler", 0.0) != 0.0;
  return {.noise = {.gyro_sigma_radps = parameters_.not_negative("gyro_sigma_radps"),
                    .accelerometer_sigma_mps2 = parameters_.not_negative("accelerometer_sigma_mps2")},
          .integration = euler ? inertial::PlanarIntegration::kEuler : inertial::PlanarIntegration::kZeroOrderHold};
}

PlanarOdometry AnyProcess::planar_odometry() const {
  const auto numbers = parameters_.numbers("covariance", {9});
  const Eigen::Matrix3d covariance = Eigen::Map<const Eigen::Matrix3d>(numbers.data());
  check_covariance(covariance, "covariance");
  PlanarOdometry odometry;
  if (!soopnav::detail::semidefinite_root(covariance, odometry.noise_root)) {
    throw std::invalid_argument("covariance: has no triangular root");
  }
  return odometry;
}

void AnyProcess::check_clock(bool state_has_clock, std::string_view state) const {
  if (state_has_clock && !clock_) {
    throw std::invalid_argument("clock: state '" + std::string(state) +
                                "' has a clock of bias and drift; give its power densities, (0, 0) for a perfect one");
  }
  if (!state_has_clock && clock_) {
    throw std::invalid_argument("clock: state '" + std::string(state) + "' has no clock of bias and drift");
  }
}

void AnyProcess::refuse_state(std::string_view state, std::string_view lacking) const {
  throw std::invalid_argument(kind_ + " moves " + std::string(lacking) + ", which state '" + std::string(state) +
                              "' does not have");
}

}  // namespace soopnav::python

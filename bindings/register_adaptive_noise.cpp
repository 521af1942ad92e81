#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "kalman_arguments.hpp"
#include "register.hpp"
#include "soopnav/estimation/adaptive_noise.hpp"

namespace soopnav::python {

namespace {

// The parameters of the process models that are noise, all of them; motions are linear in their deviations.
bool is_density(const std::string& name) {
  return name.ends_with("psd") || name == "clock" || name == "covariance";  // of power: they grow as the multiplier
}
bool is_deviation(const std::string& name) { return name.find("_sigma_") != std::string::npos; }

bool observe(AdaptiveProcessNoise& self, const KalmanReport& report, const Numbers<"R">& R) {
  return learn(self, report, to_square(R, static_cast<std::size_t>(report.rows), "R").data());
}

py::tuple save_noise(const AdaptiveProcessNoise& self) {
  const AdaptiveNoiseOptions& o = self.options();
  return py::make_tuple(o.initial, o.lower, o.upper, o.memory, o.prior_information, self.log_multiplier(),
                        self.information());
}

AdaptiveProcessNoise make_noise(double initial, double lower, double upper, double memory, double prior_information) {
  return AdaptiveProcessNoise(
      {.initial = initial, .lower = lower, .upper = upper, .memory = memory, .prior_information = prior_information});
}

AdaptiveProcessNoise load_noise(const py::tuple& saved) {
  if (saved.size() != 7) throw py::value_error("saved noise: expected 7 parts, got " + std::to_string(saved.size()));
  const auto number = [&saved](std::size_t i) { return saved[i].cast<double>(); };
  AdaptiveProcessNoise noise = make_noise(number(0), number(1), number(2), number(3), number(4));
  noise.restore(number(5), number(6));
  return noise;
}

}  // namespace

AnyProcess scaled_noise(const AnyProcess& process, double multiplier) {
  Parameters::Values values = process.parameters().values();
  const double root = std::sqrt(multiplier);
  for (auto& [name, numbers] : values) {
    if (!is_density(name) && !is_deviation(name)) continue;
    for (double& value : numbers) value *= is_density(name) ? multiplier : root;
  }
  return {process.kind(), Parameters(std::move(values))};
}

bool learn(AdaptiveProcessNoise& noise, const KalmanReport& report, const double* R) noexcept {
  const Eigen::Index m = report.rows;
  UpdateReport<Eigen::Dynamic, kMostRows> from(report.rows);
  from.status = report.status;
  from.innovation = Eigen::Map<const Eigen::VectorXd>(report.innovation.data(), m);
  from.covariance = Eigen::Map<const Eigen::MatrixXd>(report.covariance.data(), m, m);
  from.nis = report.nis;
  return noise.observe(from, Eigen::Map<const Eigen::MatrixXd>(R, m, m));
}

void register_adaptive_noise(py::module_& m) {
  py::class_<AdaptiveProcessNoise>(m, "AdaptiveProcessNoise",
                                   "A multiplier on the process noise: see soopnav_cpp.estimation.")
      .def(py::init(&make_noise), py::kw_only(), py::arg("initial"), py::arg("lower"), py::arg("upper"),
           py::arg("memory"), py::arg("prior_information"))
      .def_property_readonly("multiplier", &AdaptiveProcessNoise::multiplier)
      .def_property_readonly("information", &AdaptiveProcessNoise::information)
      .def_property_readonly("options",
                             [](const AdaptiveProcessNoise& self) {
                               const AdaptiveNoiseOptions& o = self.options();
                               return py::make_tuple(o.initial, o.lower, o.upper, o.memory, o.prior_information);
                             })
      .def(
          "scaled",
          [](const AdaptiveProcessNoise& self, const AnyProcess& process) {
            return scaled_noise(process, self.multiplier());
          },
          py::arg("process"))
      .def("observe", &observe, py::arg("report"), py::arg("R"))
      .def("clone", [](const AdaptiveProcessNoise& self) { return self; })
      .def(py::pickle(&save_noise, &load_noise));
}

}  // namespace soopnav::python

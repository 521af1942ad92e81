#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cstdint>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/navigation/sop_catalog.hpp"
#include "soopnav/navigation/sop_fusion.hpp"

namespace soopnav::python {

namespace {

using navigation::SopEstimate;
using navigation::SopFusionStatus;

template <int N>
py::tuple sop_tuple(const SopEstimate<N>& e) {
  std::vector<double> value(e.value.data(), e.value.data() + N);
  std::vector<double> covariance(e.covariance.data(), e.covariance.data() + N * N);  // symmetric
  return py::make_tuple(to_array(std::move(value)), to_array(std::move(covariance), {N, N}));
}

/// Rows of numbers as estimates; `at` one time for each.
template <int N>
std::vector<SopEstimate<N>> sop_estimates(const RealArrayBase& at, const NumbersBase& value,
                                          const NumbersBase& covariance, const std::vector<bool>& independent) {
  const std::size_t n = at.size();
  if (value.span().size() != n * N || covariance.span().size() != n * N * N || independent.size() != n) {
    throw std::invalid_argument("value, covariance, independent: " + std::to_string(n) + " of each expected, of " +
                                std::to_string(N) + " numbers");
  }
  std::vector<SopEstimate<N>> out(n);
  for (std::size_t i = 0; i < n; ++i) {
    out[i].t_s = at[i];
    for (int k = 0; k < N; ++k) out[i].value[k] = value.span()[i * N + static_cast<std::size_t>(k)];
    for (int k = 0; k < N * N; ++k)
      out[i].covariance.data()[k] = covariance.span()[i * N * N + static_cast<std::size_t>(k)];
    out[i].independent = independent[i];
  }
  return out;
}

py::object sop_result(SopFusionStatus status, const py::tuple& found) {
  switch (status) {
    case SopFusionStatus::kOk:
      return found;
    case SopFusionStatus::kEmpty:
      throw std::invalid_argument("value: at least one estimate expected");
    case SopFusionStatus::kUnordered:
      throw std::invalid_argument("t_s: times that do not fall expected");
    case SopFusionStatus::kUndefined:
      break;
  }
  throw std::invalid_argument("value, covariance: finite numbers and positive semi-definite matrices expected");
}

template <int N>
py::object sop_fuse_constants(const RealArrayBase& t_s, const NumbersBase& value, const NumbersBase& covariance,
                              const std::vector<bool>& independent, double variance_per_s, double at_s) {
  const auto all = sop_estimates<N>(t_s, value, covariance, independent);
  SopEstimate<N> out;
  const auto status = navigation::fuse_constants<N>(all, variance_per_s, at_s, out);
  return sop_result(status, sop_tuple(out));
}

template <int N>
SopEstimate<N> sop_one(const NumbersBase& value, const NumbersBase& covariance, bool independent) {
  if (value.span().size() != N || covariance.span().size() != N * N) {
    throw std::invalid_argument("value, covariance: " + std::to_string(N) + " numbers and a matrix of them expected");
  }
  SopEstimate<N> out;
  for (int k = 0; k < N; ++k) out.value[k] = value.span()[static_cast<std::size_t>(k)];
  for (int k = 0; k < N * N; ++k) out.covariance.data()[k] = covariance.span()[static_cast<std::size_t>(k)];
  out.independent = independent;
  return out;
}

template <int N>
py::tuple sop_intersect(const NumbersBase& a, const NumbersBase& A, const NumbersBase& b, const NumbersBase& B) {
  SopEstimate<N> left = sop_one<N>(a, A, false);
  const double weight = navigation::intersect(left, sop_one<N>(b, B, false));
  const py::tuple found = sop_tuple(left);
  return py::make_tuple(found[0], found[1], weight);
}

using navigation::SopCatalog;
using navigation::SopSource;

constexpr double kSopMicrosecond = 1e-6;

template <int N>
void sop_part(const py::dict& from, const char* name, std::optional<SopEstimate<N>>& out) {
  if (!from.contains(name) || from[name].is_none()) return;
  const auto pair = from[name].cast<py::tuple>();
  if (pair.size() != 2) throw std::invalid_argument(std::string(name) + ": (value, covariance) expected");
  out = sop_one<N>(Numbers<"value">(pair[0]), Numbers<"covariance">(pair[1]), true);
}

SopSource sop_source(const py::dict& from) {
  SopSource out;
  out.id = from["id"].cast<std::string>();
  out.name = from["name"].cast<std::string>();
  const auto kind = from["kind"].cast<std::string>();
  std::uint8_t k = 0;
  while (k < 7 && navigation::to_string(static_cast<navigation::SopKind>(k)) != kind) ++k;
  if (k == 7) throw std::invalid_argument("kind = " + kind + " must be a kind of source");
  out.kind = static_cast<navigation::SopKind>(k);
  out.carrier_hz = from["carrier_hz"].cast<double>();
  out.contributions = from["contributions"].cast<std::uint32_t>();
  out.newest_us = from["newest_us"].cast<std::int64_t>();
  out.at_us = from["at_us"].cast<std::int64_t>();
  const auto grade = from["grade"].cast<std::string>();
  out.grade = grade.size() == 1 ? grade[0] : '?';
  sop_part<3>(from, "position", out.position);
  sop_part<2>(from, "clock", out.clock);
  std::optional<SopEstimate<2>> noise;
  sop_part<2>(from, "noise", noise);
  if (noise) out.noise = navigation::SopNoise{noise->value, noise->covariance};
  return out;
}

template <int N>
py::object sop_or_none(const std::optional<SopEstimate<N>>& e) {
  return e ? py::object(sop_tuple(*e)) : py::object(py::none());
}

py::dict sop_dict(const SopSource& source) {
  py::dict out;
  out["id"] = source.id;
  out["name"] = py::reinterpret_steal<py::str>(
      PyUnicode_DecodeUTF8(source.name.data(), static_cast<py::ssize_t>(source.name.size()), "replace"));
  out["kind"] = std::string(navigation::to_string(source.kind));
  out["carrier_hz"] = source.carrier_hz;
  out["contributions"] = source.contributions;
  out["newest_us"] = source.newest_us;
  out["at_us"] = source.at_us;
  out["grade"] = std::string(1, source.grade);
  out["position"] = sop_or_none(source.position);
  out["clock"] = sop_or_none(source.clock);
  std::optional<SopEstimate<2>> noise;
  if (source.noise) {
    noise.emplace();
    noise->value = source.noise->ln_h;
    noise->covariance = source.noise->ln_covariance;
  }
  out["noise"] = sop_or_none(noise);
  return out;
}

std::vector<std::string> sop_ids(const std::vector<const SopSource*>& found, std::size_t count) {
  std::vector<std::string> out;
  for (std::size_t i = 0; i < std::min(count, found.size()); ++i) out.push_back(found[i]->id);
  return out;
}

const SopSource& sop_named(const SopCatalog& catalog, const std::string& id) {
  const SopSource* const found = catalog.find(id);
  if (found == nullptr) throw std::invalid_argument("id = " + id + " must be one of the catalogue's");
  return *found;
}

Epoch sop_epoch(std::int64_t us) {
  return {TimeScale::kUtc, us / 1'000'000, static_cast<double>(us % 1'000'000) * kSopMicrosecond};
}

py::dict sop_prior(const SopCatalog& catalog, const std::string& id, std::int64_t at_us) {
  navigation::SopPrior prior;
  if (!navigation::prior(sop_named(catalog, id), sop_epoch(at_us), prior)) {
    throw std::invalid_argument("at_us: a time near enough for finite covariances expected");
  }
  SopEstimate<3> position;
  position.value = prior.p_e_m;
  position.covariance = prior.position_covariance_m2;
  SopEstimate<2> clock;
  clock.value = prior.clock;
  clock.covariance = prior.clock_covariance;
  py::dict out;
  out["carrier_hz"] = prior.carrier_hz;
  out["position"] = prior.has_position ? py::object(sop_tuple(position)) : py::object(py::none());
  out["clock"] = prior.has_clock ? py::object(sop_tuple(clock)) : py::object(py::none());
  out["has_noise"] = prior.has_noise;
  out["noise"] = py::make_tuple(prior.noise.white_frequency_m2ps, prior.noise.frequency_walk_m2ps3);
  return out;
}

}  // namespace

void register_sop_catalog(py::module_& module) {
  module.def(
      "sop_write_snapshot",
      [](const std::vector<py::dict>& sources, std::int64_t created_us) {
        std::vector<SopSource> all;
        all.reserve(sources.size());
        for (const py::dict& source : sources) all.push_back(sop_source(source));
        const std::vector<std::byte> out = navigation::write_snapshot(all, created_us);
        return py::bytes(reinterpret_cast<const char*>(out.data()), out.size());
      },
      py::arg("sources"), py::arg("created_us"), "The bytes of a snapshot.");
  py::class_<SopCatalog>(module, "SopCatalog", "Sources of a snapshot.")
      .def(py::init([](const py::bytes& bytes) {
             const std::string_view view(bytes);
             return SopCatalog::read(std::as_bytes(std::span(view.data(), view.size())));
           }),
           py::arg("bytes"))
      .def_property_readonly("created_us", &SopCatalog::created_us)
      .def("__len__", [](const SopCatalog& self) { return self.sources().size(); })
      .def("__repr__",
           [](const SopCatalog& self) { return "SopCatalog(" + grouped(self.sources().size()) + " sources)"; })
      .def("ids",
           [](const SopCatalog& self) {
             std::vector<std::string> out;
             for (const SopSource& source : self.sources()) out.push_back(source.id);
             return out;
           })
      .def(
          "source", [](const SopCatalog& self, const std::string& id) { return sop_dict(sop_named(self, id)); },
          py::arg("id"))
      .def(
          "near",
          [](const SopCatalog& self, const Numbers<"p_e_m">& p_e_m, double radius_m) {
            const auto p = p_e_m.span();
            if (p.size() != 3) throw std::invalid_argument("p_e_m: three numbers expected");
            std::vector<const SopSource*> found(self.sources().size());
            const std::size_t count = self.near(Eigen::Vector3d(p[0], p[1], p[2]), radius_m, found);
            return sop_ids(found, count);
          },
          py::arg("p_e_m"), py::arg("radius_m"))
      .def("prior", &sop_prior, py::arg("id"), py::arg("at_us"));
  module.def(
      "sop_move_clock",
      [](const Numbers<"value">& value, const Numbers<"covariance">& covariance, double h0, double h_minus_2,
         double dt_s) {
        SopEstimate<2> clock = sop_one<2>(value, covariance, true);
        if (!navigation::move_clock(clock, {h0, h_minus_2}, dt_s)) {
          throw std::invalid_argument("value, covariance, h0, h_minus_2, dt_s: finite numbers, h >= 0 expected");
        }
        return sop_tuple(clock);
      },
      py::arg("value"), py::arg("covariance"), py::kw_only(), py::arg("h0"), py::arg("h_minus_2"), py::arg("dt_s"),
      "Offset [s] and drift of a clock dt_s later, and their covariance.");
  module.def(
      "sop_fuse_clocks",
      [](const RealArray<"t_s">& t_s, const Numbers<"value">& value, const Numbers<"covariance">& covariance,
         const std::vector<bool>& independent, double h0, double h_minus_2, double at_s) {
        const auto all = sop_estimates<2>(t_s, value, covariance, independent);
        SopEstimate<2> out;
        const auto status = navigation::fuse_clocks(all, {h0, h_minus_2}, at_s, out);
        return sop_result(status, sop_tuple(out));
      },
      py::arg("t_s"), py::arg("value"), py::arg("covariance"), py::arg("independent"), py::kw_only(), py::arg("h0"),
      py::arg("h_minus_2"), py::arg("at_s"), "Estimates of one clock, ordered by time, fused at `at_s`.");
  module.def(
      "sop_fuse_constants",
      [](const RealArray<"t_s">& t_s, const Numbers<"value">& value, const Numbers<"covariance">& covariance,
         const std::vector<bool>& independent, double variance_per_s, double at_s) {
        const std::size_t size = t_s.size() == 0 ? 0 : value.span().size() / t_s.size();
        if (size == 2) return sop_fuse_constants<2>(t_s, value, covariance, independent, variance_per_s, at_s);
        if (size == 3) return sop_fuse_constants<3>(t_s, value, covariance, independent, variance_per_s, at_s);
        throw std::invalid_argument("value: shape (n, 2) or (n, 3) with n > 0 expected");
      },
      py::arg("t_s"), py::arg("value"), py::arg("covariance"), py::arg("independent"), py::kw_only(),
      py::arg("variance_per_s"), py::arg("at_s"), "Estimates of two or three constants, ordered by time, fused.");
  module.def(
      "sop_disagreement",
      [](const Numbers<"a">& a, const Numbers<"A">& A, const Numbers<"b">& b, const Numbers<"B">& B, bool independent) {
        const bool two = a.span().size() == 2;
        const double d2 = two ? navigation::disagreement(sop_one<2>(a, A, independent), sop_one<2>(b, B, independent))
                              : navigation::disagreement(sop_one<3>(a, A, independent), sop_one<3>(b, B, independent));
        return py::make_tuple(d2, regularized_gamma_q(two ? 1.0 : 1.5, 0.5 * d2));
      },
      py::arg("a"), py::arg("A"), py::arg("b"), py::arg("B"), py::arg("independent") = true,
      "Squared Mahalanobis distance of two estimates, and the probability of as much or more.");
  module.def(
      "sop_intersect",
      [](const Numbers<"a">& a, const Numbers<"A">& A, const Numbers<"b">& b, const Numbers<"B">& B) {
        return a.span().size() == 2 ? sop_intersect<2>(a, A, b, B) : sop_intersect<3>(a, A, b, B);
      },
      py::arg("a"), py::arg("A"), py::arg("b"), py::arg("B"),
      "Covariance intersection: value, covariance, weight of a.");
  module.def(
      "sop_least_variances",
      [](double h0, double h_minus_2, double duration_s) {
        return py::make_tuple(navigation::least_drift_variance({h0, h_minus_2}, duration_s),
                              navigation::least_ln_walk_variance({h0, h_minus_2}, duration_s));
      },
      py::arg("h0"), py::arg("h_minus_2"), py::arg("duration_s"),
      "Least variance of the drift and of ln h-2 that a record of this length allows.");
}

}  // namespace soopnav::python

// Laws of the array module in C++: bits, derivatives, statuses. What needs statistics or references is in Python.

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>
#include <vector>

#include "array/kernels.hpp"
#include "soopnav/array/direction_finder.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"

namespace soopnav::array {

namespace kernels_baseline {
// kernels.cpp compiled for the baseline only, in kernels_baseline.cpp.
void covariance_sums(const Cf32* iq, std::size_t channels, std::size_t stride, std::size_t count, double* power,
                     double* re, double* im) noexcept;
std::size_t scan(const float* table, std::size_t groups, std::size_t elements, const float* vectors, std::size_t count,
                 float* out) noexcept;
}  // namespace kernels_baseline

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

std::vector<Cf32> samples(std::size_t count, std::uint64_t seed) {
  std::vector<Cf32> out(count);
  RandomStream(seed).fill_complex_normal(out);
  return out;
}

TEST(ArrayKernels, SameBitsForAnyVectorWidth) {
  for (const std::size_t channels : {1U, 2U, 4U, 7U}) {
    for (const std::size_t count : {1U, 8U, 255U, 256U, 257U, 2500U}) {
      const auto iq = samples(channels * count, channels + count);
      std::vector<double> a(2 * channels * channels + channels), b(a.size());
      const std::size_t pairs = channels * channels;
      kernels::covariance_sums(iq.data(), channels, count, count, a.data(), a.data() + channels,
                               a.data() + channels + pairs);
      kernels_baseline::covariance_sums(iq.data(), channels, count, count, b.data(), b.data() + channels,
                                        b.data() + channels + pairs);
      EXPECT_EQ(a, b) << channels << " " << count;
    }
  }
  for (const std::size_t elements : {2U, 4U, 9U}) {
    for (const std::size_t groups : {1U, 8U, 13U}) {
      RandomStream random(elements + groups);
      std::vector<float> table(groups * 2 * elements * kernels::kLanes), vectors(4 * elements);
      random.fill_normal(table);
      random.fill_normal(vectors);
      std::vector<float> a(groups * kernels::kLanes), b(a.size());
      const auto top = kernels::scan(table.data(), groups, elements, vectors.data(), 2, a.data());
      EXPECT_EQ(top, kernels_baseline::scan(table.data(), groups, elements, vectors.data(), 2, b.data()));
      EXPECT_EQ(a, b);
      EXPECT_EQ(top, static_cast<std::size_t>(std::max_element(a.begin(), a.end()) - a.begin()));
    }
  }
}

TEST(ArrayCovariance, IsTheDefinition) {
  const std::size_t channels = 5, count = 777, stride = 800;
  const auto iq = samples(channels * stride, 3);
  ComplexMatrix R;
  ASSERT_EQ(covariance({iq.data(), channels, count, stride}, R).status, ArrayStatus::kOk);
  for (std::size_t i = 0; i < channels; ++i) {
    for (std::size_t j = 0; j < channels; ++j) {
      Cf64 sum = 0.0;
      for (std::size_t n = 0; n < count; ++n) sum += Cf64(iq[i * stride + n]) * std::conj(Cf64(iq[j * stride + n]));
      const Cf64 got = R(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j));
      EXPECT_LT(std::abs(got - sum / static_cast<double>(count)), 1e-6) << i << " " << j;
    }
  }
}

TEST(ArrayEigen, ReconstructsAndOrders) {
  for (const std::size_t n : {1U, 2U, 4U, 13U, 32U}) {
    const auto iq = samples(n * 3 * n, n);
    ComplexMatrix R;
    ASSERT_EQ(covariance({iq.data(), n, 3 * n, 3 * n}, R).status, ArrayStatus::kOk);
    HermitianEigen eigen;
    ASSERT_TRUE(hermitian_eigen(R, eigen));
    const auto size = static_cast<Eigen::Index>(n);
    for (Eigen::Index i = 0; i < size; ++i) {
      if (i > 0) {
        EXPECT_GE(eigen.values[i - 1], eigen.values[i]);
      }
      for (Eigen::Index j = 0; j < size; ++j) {
        Cf64 sum = 0.0, dot = 0.0;
        for (Eigen::Index k = 0; k < size; ++k) {
          sum += eigen.vectors(i, k) * eigen.values[k] * std::conj(eigen.vectors(j, k));
          dot += std::conj(eigen.vectors(k, i)) * eigen.vectors(k, j);
        }
        EXPECT_LT(std::abs(sum - R(i, j)), 1e-13 * eigen.values[0]);
        EXPECT_LT(std::abs(dot - (i == j ? 1.0 : 0.0)), 1e-13);
      }
    }
    R(0, 0) = kNan;
    EXPECT_FALSE(hermitian_eigen(R, eigen));
  }
}

TEST(ArrayPolynomial, RootsOfKnownPolynomials) {
  // (z - 2)(z + 3j)(z - 0.5 - 0.5j)
  const Cf64 wanted[] = {{2.0, 0.0}, {0.0, -3.0}, {0.5, 0.5}};
  std::vector<Cf64> coefficients{1.0};
  for (const Cf64& root : wanted) {
    coefficients.emplace_back(0.0);
    for (std::size_t i = coefficients.size() - 1; i > 0; --i) coefficients[i] -= root * coefficients[i - 1];
  }
  std::vector<Cf64> roots(3);
  ASSERT_TRUE(polynomial_roots(coefficients, roots));
  for (const Cf64& root : wanted) {
    double nearest = 1.0;
    for (const Cf64& z : roots) nearest = std::min(nearest, std::abs(z - root));
    EXPECT_LT(nearest, 1e-14);
  }
  coefficients[0] = 0.0;
  EXPECT_FALSE(polynomial_roots(coefficients, roots));
  coefficients[0] = kNan;
  EXPECT_FALSE(polynomial_roots(coefficients, roots));
}

// A smooth measured response: values and slopes of the interpolation are then those of the function.
Manifold measured() {
  const auto geometry = ArrayGeometry::uca(5, 0.45);
  ResponseGrid grid;
  grid.frequency_hz = {1.5e9, 1.6e9};
  for (int i = 0; i < 180; ++i) grid.azimuth_rad.push_back(-kPi + kTwoPi * i / 180);
  for (int i = 0; i <= 45; ++i) grid.elevation_rad.push_back(kPi / 2 * i / 45);
  for (const double f : grid.frequency_hz) {
    for (const double el : grid.elevation_rad) {
      for (const double az : grid.azimuth_rad) {
        for (int m = 0; m < 5; ++m) {
          const double tilt = std::cos(el) * std::cos(az - m);  // smooth over the pole
          grid.correction.emplace_back(1.0 + 0.2 * tilt + 0.1 * (f - 1.5e9) / 1e8, 0.15 * tilt * m);
        }
      }
    }
  }
  return {geometry, grid};
}

TEST(ArrayManifold, DerivativesAreThoseOfTheSteeringVector) {
  const auto geometry = ArrayGeometry::planar(3, 2, 0.4);
  ComplexMatrix coupling = ComplexMatrix::Identity(6, 6);
  coupling(0, 1) = Cf64(0.1, -0.2);
  coupling(4, 2) = Cf64(-0.15, 0.05);
  const double gains[] = {1.0, -2.0, 0.5, 0.0, 3.0, -1.0}, phases[] = {0.1, 0.2, -0.3, 0.0, 1.0, -2.0};
  const Manifold ideal(geometry);
  const Manifold coupled = ideal.with_errors(gains, phases).with_coupling(coupling);
  const Manifold table = measured();
  for (const Manifold* manifold : {&ideal, &coupled, &table}) {
    const bool interpolated = manifold == &table;
    const double f = manifold->geometry().frequency_hz();
    for (const Direction direction : {Direction{0.3, 0.5}, Direction{-2.0, 1.2}, Direction{1.0, 0.05}}) {
      const Eigen::Vector3d u = unit_vector(direction);
      const Eigen::Vector3d t0(-std::sin(direction.azimuth_rad), std::cos(direction.azimuth_rad), 0.0);
      const Eigen::Vector3d t1 = u.cross(t0);
      SteeringJet jet;
      ASSERT_TRUE(manifold->steering(u, t0, t1, f, jet));
      const double h = interpolated ? 2e-3 : 1e-4;
      const auto at = [&](double x, double y) {
        ComplexVector a;
        const double angle = std::hypot(x, y);
        const Eigen::Vector3d along = angle > 0.0 ? Eigen::Vector3d((x * t0 + y * t1) / angle) : t0;
        EXPECT_TRUE(manifold->steering(std::cos(angle) * u + std::sin(angle) * along, f, a));
        return a;
      };
      const ComplexVector middle = at(0, 0), east = at(h, 0), west = at(-h, 0), north = at(0, h), south = at(0, -h);
      const double first = interpolated ? 2e-3 : 1e-6, second = interpolated ? 2.5 : 1e-5;
      for (Eigen::Index m = 0; m < middle.size(); ++m) {
        EXPECT_LT(std::abs(jet.value[m] - middle[m]), 1e-12);
        EXPECT_LT(std::abs(jet.first[0][m] - (east[m] - west[m]) / (2 * h)), first);
        EXPECT_LT(std::abs(jet.first[1][m] - (north[m] - south[m]) / (2 * h)), first);
        EXPECT_LT(std::abs(jet.second[0][m] - (east[m] + west[m] - 2.0 * middle[m]) / (h * h)), second);
        EXPECT_LT(std::abs(jet.second[2][m] - (north[m] + south[m] - 2.0 * middle[m]) / (h * h)), second);
        const Cf64 mixed = (at(h, h)[m] - at(h, -h)[m] - at(-h, h)[m] + at(-h, -h)[m]) / (4 * h * h);
        EXPECT_LT(std::abs(jet.second[1][m] - mixed), second);
      }
    }
  }
}

TEST(ArrayFinder, StatusesOfBadData) {
  const auto table = std::make_shared<const SteeringTable>(Manifold(ArrayGeometry::planar(2, 2, 0.2)),
                                                           GridOptions{0.05, 0.05, 0.0, 0.0, 0.0});
  DirectionFinder finder(table, {DirectionMethod::kMusic, 2, 0.0, false});
  auto iq = samples(4 * 100, 1);
  EXPECT_EQ(finder.estimate({iq.data(), 3, 100, 100}).status, ArrayStatus::kWrongSize);
  EXPECT_EQ(finder.estimate({iq.data(), 4, 3, 100}).status, ArrayStatus::kTooFewSnapshots);
  EXPECT_EQ(finder.estimate({iq.data(), 4, 0, 100}).status, ArrayStatus::kTooFewSnapshots);
  iq[250] = Cf32(std::numeric_limits<float>::quiet_NaN(), 0.0F);
  auto found = finder.estimate({iq.data(), 4, 100, 100});
  EXPECT_EQ(found.status, ArrayStatus::kNonFinite);
  EXPECT_EQ(found.channel, 2);
  EXPECT_TRUE(found.sources.empty());
  std::fill(iq.begin() + 200, iq.begin() + 300, Cf32(0.0F, 0.0F));
  found = finder.estimate({iq.data(), 4, 100, 100});
  EXPECT_EQ(found.status, ArrayStatus::kDeadChannel);
  EXPECT_EQ(found.channel, 2);
  EXPECT_EQ(finder.estimate(ComplexMatrix::Zero(4, 4), 100.0).status, ArrayStatus::kSingular);
  EXPECT_EQ(finder.estimate(ComplexMatrix::Ones(4, 4), 100.0).status, ArrayStatus::kSingular);  // rank 1, 2 sources
  EXPECT_EQ(finder.estimate(ComplexMatrix::Identity(4, 4), kNan).status, ArrayStatus::kTooFewSnapshots);
  EXPECT_EQ(finder.estimate(ComplexMatrix::Identity(3, 3), 100.0).status, ArrayStatus::kWrongSize);
  EXPECT_EQ(finder.estimate(ComplexMatrix::Constant(4, 4, kNan), 100.0).status, ArrayStatus::kNonFinite);
  EXPECT_TRUE(found.mirror);
  EXPECT_THROW(DirectionFinder(table, {DirectionMethod::kMusic, 4, 0.0, false}), std::invalid_argument);
}

// Squares that single precision cannot hold are no dead channel.
TEST(ArrayCovariance, FaintSamplesAreNotDead) {
  auto iq = samples(4 * 100, 3);
  ComplexMatrix R, faint;
  ASSERT_EQ(covariance({iq.data(), 4, 100, 100}, R).status, ArrayStatus::kOk);
  for (Cf32& x : iq) x = {std::ldexp(x.real(), -83), std::ldexp(x.imag(), -83)};  // 1e-25
  ASSERT_EQ(covariance({iq.data(), 4, 100, 100}, faint).status, ArrayStatus::kOk);
  EXPECT_LT((std::ldexp(1.0, 166) * faint - R).cwiseAbs().maxCoeff(), 1e-6);
  std::fill(iq.begin() + 100, iq.begin() + 200, Cf32(0.0F, 0.0F));
  const CovarianceReport report = covariance({iq.data(), 4, 100, 100}, faint);
  EXPECT_EQ(report.status, ArrayStatus::kDeadChannel);
  EXPECT_EQ(report.channel, 1);
}

// A plane by its positions whose measured responses are those of `real` elements, over the whole sphere.
Manifold measured_sphere(const ArrayGeometry& plane, const ArrayGeometry& real) {
  const Manifold truth(real), nominal(plane);
  ResponseGrid grid;
  grid.frequency_hz = {plane.frequency_hz()};
  for (int i = 0; i < 36; ++i) grid.azimuth_rad.push_back(i * kPi / 18.0);
  for (int i = -9; i <= 9; ++i) grid.elevation_rad.push_back(i * kPi / 18.0);
  ComplexVector a, b;
  for (const double elevation : grid.elevation_rad) {
    for (const double azimuth : grid.azimuth_rad) {
      const Eigen::Vector3d u = unit_vector({azimuth, elevation});
      EXPECT_TRUE(truth.steering(u, plane.frequency_hz(), a) && nominal.steering(u, plane.frequency_hz(), b));
      for (Eigen::Index m = 0; m < a.size(); ++m) grid.correction.push_back(a[m] / b[m]);
    }
  }
  return {plane, grid};
}

// Elements somewhat out of their plane tell its sides apart: a measured direction is not mirrored.
TEST(ArrayFinder, MeasuredResponsesDecideTheSideOfAPlane) {
  const auto plane = ArrayGeometry::planar(2, 2, 0.4);
  auto positions = plane.positions_m();
  positions[1][2] = 0.03;
  positions[2][2] = 0.01;
  positions[3][2] = 0.02;
  const Manifold bent = measured_sphere(plane, ArrayGeometry(positions, plane.frequency_hz()));
  const double lowest = -kPi / 6;
  const auto table = std::make_shared<const SteeringTable>(bent, GridOptions{0.05, 0.05, lowest, 0.0, 0.0});
  EXPECT_FALSE(table->mirror());
  for (const DirectionMethod method : {DirectionMethod::kMusic, DirectionMethod::kMaximumLikelihood}) {
    DirectionFinder finder(table, {method, 1, 0.0, false});
    for (const double elevation : {-0.17, 0.4}) {
      ComplexVector a;
      ASSERT_TRUE(bent.steering(unit_vector({0.7, elevation}), plane.frequency_hz(), a));
      const Bearings found = finder.estimate(a * a.adjoint() + ComplexMatrix::Identity(4, 4), 1000.0);
      ASSERT_EQ(found.status, ArrayStatus::kOk);
      EXPECT_FALSE(found.mirror);
      EXPECT_NEAR(found.sources[0].azimuth_rad, 0.7, 2e-3);
      EXPECT_NEAR(found.sources[0].elevation_rad, elevation, 2e-3);
    }
  }
  // Not so where the grid has one side only, or where the responses are alike on both.
  EXPECT_TRUE(SteeringTable(bent, GridOptions{0.05, 0.05, 0.0, 0.0, 0.0}).mirror());
  EXPECT_TRUE(SteeringTable(measured_sphere(plane, plane), GridOptions{0.05, 0.05, lowest, 0.0, 0.0}).mirror());
  EXPECT_TRUE(SteeringTable(Manifold(plane), GridOptions{0.05, 0.05, lowest, 0.0, 0.0}).mirror());
}

// The refinement finds the direction of a noise-free covariance anywhere: zenith, horizon, between grid points.
TEST(ArrayFinder, NoiseFreeDirectionsAnywhere) {
  const Manifold plain(ArrayGeometry::uca(6, 0.4));
  for (const DirectionMethod method : {DirectionMethod::kMusic, DirectionMethod::kBartlett, DirectionMethod::kCapon,
                                       DirectionMethod::kSubspaceFitting, DirectionMethod::kMaximumLikelihood}) {
    const auto table = std::make_shared<const SteeringTable>(plain, GridOptions{0.07, 0.07, 0.0, 0.3, 0.0});
    DirectionFinder finder(table, {method, 1, 1e-9, false});
    for (const Direction direction : {Direction{0.3, 0.5}, Direction{-3.1, 0.9}, Direction{1.234, 1.5},
                                      Direction{2.0, 0.1}, Direction{0.0, 1.5707963}}) {
      ComplexVector a;
      ASSERT_TRUE(plain.steering(unit_vector(direction), plain.geometry().frequency_hz(), a));
      const ComplexMatrix R = 2.0 * a.lazyProduct(a.adjoint()) + ComplexMatrix(ComplexMatrix::Identity(6, 6));
      const Bearings found = finder.estimate(R, 1000.0);
      ASSERT_EQ(found.status, ArrayStatus::kOk);
      const auto& source = found.sources[0];
      const Eigen::Vector3d u = unit_vector({source.azimuth_rad, source.elevation_rad});
      EXPECT_LT((u - unit_vector(direction)).norm(), 1e-7) << static_cast<int>(method);
      EXPECT_NEAR(source.power, 2.0, 1e-6);
      EXPECT_TRUE(source.covariance_rad2.allFinite());
    }
  }
}

}  // namespace
}  // namespace soopnav::array

#include "soopnav/estimation/fixed_lag_filter.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

#include "estimation/tracking_scene.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/estimation/square_root_kalman_filter.hpp"
#include "soopnav/inertial/planar_mechanization.hpp"

namespace soopnav {
namespace {

using test::Fix;
using test::Motion;
using test::PlanarRange;
using test::Vehicle;

Epoch at(double t_s) { return Epoch::from_seconds(TimeScale::kGps, 1e9) + t_s; }

template <class Filter>
class FixedLag : public testing::Test {};
using Filters = testing::Types<ExtendedKalmanFilter<Vehicle>, SquareRootKalmanFilter<Vehicle>>;
TYPED_TEST_SUITE(FixedLag, Filters);

struct Event {
  double t_s;
  int kind;  // 0 a fix, 1 a range, 2 an outlier, which the gate keeps out, 3 nothing: advance
};

TYPED_TEST(FixedLag, LateEqualsInOrderToTheBit) {
  using Lagged = FixedLagFilter<TypeParam, Motion, Fix, PlanarRange>;
  const Motion motion{{0.2, 0.1}};
  const TypeParam start(test::vehicle(0, 0, 2, 1), Eigen::Matrix4d::Identity());
  const Gate gate = Gate::probability(1e-3, 2);
  const auto feed = [&](Lagged& filter, const Event& e) {
    const double x = 2.0 * e.t_s + 0.3, y = e.t_s - 0.2;
    if (e.kind == 0)
      return filter.update(Observed<Fix>({}, {x, y}, Eigen::Matrix2d::Identity()), at(e.t_s), gate).status;
    if (e.kind == 3) return filter.advance(at(e.t_s));
    const double range = std::hypot(x - 50.0, y - 20.0) + (e.kind == 2 ? 40.0 : 0.1);
    return filter.update(PlanarRange{Eigen::Vector2d(50, 20)}, range, 0.25, at(e.t_s), gate).status;
  };
  std::vector<Event> events;
  for (int k = 1; k <= 30; ++k) events.push_back({0.37 * k, k % 7 == 0 ? 2 : k % 2});
  Lagged in_order(start, motion, at(0), 12);
  for (const Event& e : events) {
    EXPECT_EQ(feed(in_order, e), e.kind == 2 ? UpdateStatus::kGated : UpdateStatus::kAccepted);
  }
  // Late by up to eight places, the same every time.
  std::vector<Event> shuffled = events;
  RandomStream random(5);
  for (std::size_t k = 0; k + 8 < shuffled.size(); k += 3) {
    std::swap(shuffled[k], shuffled[k + 1 + static_cast<std::size_t>(7.0 * random.uniform())]);
  }
  ASSERT_FALSE(std::is_sorted(shuffled.begin(), shuffled.end(), [](auto& a, auto& b) { return a.t_s < b.t_s; }));
  Lagged late(start, motion, at(0), 12);
  for (const Event& e : shuffled) static_cast<void>(feed(late, e));
  EXPECT_EQ(late.state().x, in_order.state().x);
  EXPECT_EQ(late.covariance(), in_order.covariance());
  EXPECT_EQ(late.epoch(), in_order.epoch());
  EXPECT_EQ(late.oldest_epoch(), in_order.oldest_epoch());
  EXPECT_EQ(late.size(), 12);
  // And it is the filter itself.
  TypeParam plain = start;
  double now = 0.0;
  for (const Event& e : events) {
    ASSERT_EQ(plain.predict(motion, *(at(e.t_s) - at(now))), UpdateStatus::kAccepted);
    now = e.t_s;
    const double x = 2.0 * e.t_s + 0.3, y = e.t_s - 0.2;
    if (e.kind == 0) {
      static_cast<void>(plain.update(Fix{}, Eigen::Vector2d(x, y), Eigen::Matrix2d::Identity(), gate));
    } else {
      const double range = std::hypot(x - 50.0, y - 20.0) + (e.kind == 2 ? 40.0 : 0.1);
      static_cast<void>(plain.update(PlanarRange{Eigen::Vector2d(50, 20)}, range, 0.25, gate));
    }
  }
  EXPECT_EQ(in_order.state().x, plain.state().x);
  EXPECT_EQ(in_order.covariance(), plain.covariance());
}

using Lagged = FixedLagFilter<ExtendedKalmanFilter<Vehicle>, Motion, Fix, PlanarRange>;

Lagged lagged(int capacity) {
  return Lagged(ExtendedKalmanFilter<Vehicle>(test::vehicle(0, 0, 2, 1), Eigen::Matrix4d::Identity()),
                Motion{{0.2, 0.1}}, at(0), capacity);
}
Observed<Fix> fix(double x, double y) { return {Fix{}, Eigen::Vector2d(x, y), Eigen::Matrix2d::Identity()}; }

TEST(FixedLagFilter, RefusesWhatIsTooLateAndChangesNothing) {
  Lagged filter = lagged(4);
  for (int k = 1; k <= 8; ++k) ASSERT_TRUE(filter.update(fix(2.0 * k, k), at(k)).accepted());
  const auto state = filter.state().x;
  const Eigen::Matrix4d P = filter.covariance();
  const auto unchanged = [&](UpdateStatus got, UpdateStatus want) {
    EXPECT_EQ(got, want);
    EXPECT_EQ(filter.state().x, state);
    EXPECT_EQ(filter.covariance(), P);
    EXPECT_EQ(filter.epoch(), at(8));
    EXPECT_EQ(filter.oldest_epoch(), at(4));
    EXPECT_EQ(filter.size(), 4);
  };
  unchanged(filter.update(fix(7, 3.5), at(3.9)).status, UpdateStatus::kTooLate);
  unchanged(filter.update(fix(std::numeric_limits<double>::quiet_NaN(), 3.5), at(7)).status, UpdateStatus::kNonFinite);
  unchanged(filter.update(Observed<Fix>({}, {7, 3}, Eigen::Matrix2d::Zero()), at(7)).status,
            UpdateStatus::kNotPositiveDefinite);
  unchanged(filter.update(fix(7, 3.5), Epoch::invalid(TimeScale::kGps)).status, UpdateStatus::kWrongTimeScale);
  unchanged(filter.update(fix(7, 3.5), Epoch::from_seconds(TimeScale::kUtc, 7.0)).status,
            UpdateStatus::kWrongTimeScale);
  unchanged(filter.advance(at(8)), UpdateStatus::kTimeNotAdvancing);
  unchanged(filter.advance(at(6)), UpdateStatus::kTimeNotAdvancing);
  unchanged(filter.advance(Epoch::invalid(TimeScale::kGps)), UpdateStatus::kWrongTimeScale);
  // The oldest epoch itself is in time, and makes it the oldest again.
  EXPECT_TRUE(filter.update(fix(8, 4), at(4)).accepted());
  EXPECT_EQ(filter.oldest_epoch(), at(4));
  EXPECT_NE(filter.covariance(), P);
  EXPECT_EQ(filter.advance(at(9)), UpdateStatus::kAccepted);
  EXPECT_EQ(filter.epoch(), at(9));
}

TEST(FixedLagFilter, JudgesRefusedObservationsAnew) {
  // A fix far off is gated, until an older one says that the vehicle went there.
  const Gate gate{.nis = 12.0};
  Lagged filter = lagged(8);
  EXPECT_EQ(filter.update(fix(30, 1), at(1), gate).status, UpdateStatus::kGated);
  EXPECT_EQ(filter.epoch(), at(1));
  EXPECT_NEAR(filter.state().x[0], 2.0, 1e-12);
  const Observed<Fix> sure({}, Eigen::Vector2d(24, 0.5), 1e-4 * Eigen::Matrix2d::Identity());
  ASSERT_TRUE(filter.update(sure, at(0.5)).accepted());
  Lagged in_order = lagged(8);
  ASSERT_TRUE(in_order.update(sure, at(0.5)).accepted());
  ASSERT_TRUE(in_order.update(fix(30, 1), at(1), gate).accepted());
  EXPECT_EQ(filter.state().x, in_order.state().x);
}

TEST(FixedLagFilter, InputsHoldUntilTheNext) {
  using State = PlanarInertialState;
  using Mechanization = inertial::PlanarMechanization;
  using Inertial = FixedLagFilter<ExtendedKalmanFilter<State>, Mechanization, Fix>;
  const Mechanization process{{0.01, 0.1}};
  const ExtendedKalmanFilter<State> start({}, 0.1 * Eigen::Matrix<double, 5, 5>::Identity());
  const auto sample = [](int k) { return inertial::PlanarImuSample{0.1 * k, Eigen::Vector2d(1.0 + k, 0.2)}; };
  Inertial in_order(start, process, at(0), 20, sample(0));
  Inertial late(start, process, at(0), 20, sample(0));
  for (int k = 1; k <= 6; ++k) {
    ASSERT_EQ(in_order.advance(at(k), sample(k)), UpdateStatus::kAccepted);
    ASSERT_TRUE(in_order.update(fix(k, 0.1 * k), at(k + 0.4)).accepted());
  }
  // All observations first, the inputs late among them.
  for (int k = 1; k <= 6; ++k) ASSERT_TRUE(late.update(fix(k, 0.1 * k), at(k + 0.4)).accepted());
  for (int k = 1; k <= 6; ++k) ASSERT_EQ(late.advance(at(k), sample(k)), UpdateStatus::kAccepted);
  EXPECT_EQ(late.state().x, in_order.state().x);
  EXPECT_EQ(late.covariance(), in_order.covariance());
  // By hand: under sample k from k on.
  ExtendedKalmanFilter<State> plain = start;
  for (int k = 0; k <= 6; ++k) {
    if (k > 0) {
      ASSERT_EQ(plain.predict(process, sample(k), *(at(k + 0.4) - at(k))), UpdateStatus::kAccepted);
      ASSERT_TRUE(plain.update(fix(k, 0.1 * k)).accepted());
    }
    const double from = k > 0 ? k + 0.4 : 0.0;
    if (k == 6) break;
    ASSERT_EQ(plain.predict(process, sample(k), *(at(k + 1) - at(from))), UpdateStatus::kAccepted);
  }
  EXPECT_EQ(plain.state().x, in_order.state().x);
  EXPECT_EQ(in_order.advance(at(6), sample(0)), UpdateStatus::kTimeNotAdvancing);  // inputs come in order
  EXPECT_EQ(in_order.advance(at(6.2), sample(7)), UpdateStatus::kAccepted);        // though before an observation
  // A sample that is no number is refused whole: the one before it stays in force.
  const int size = in_order.size();
  const inertial::PlanarImuSample broken{std::numeric_limits<double>::quiet_NaN(), Eigen::Vector2d::Zero()};
  EXPECT_EQ(in_order.advance(at(7), broken), UpdateStatus::kNonFinite);
  EXPECT_EQ(in_order.size(), size);
  EXPECT_EQ(in_order.advance(at(7)), UpdateStatus::kAccepted);
  EXPECT_TRUE(in_order.state().x.allFinite());
}

TEST(FixedLagFilter, SmoothsOverWhatItKeeps) {
  // Everything is linear: the smoothed state at an epoch is that of all observations at once, here by letting them
  // come to a state that stands still.
  Lagged filter = lagged(20);
  const Motion motion{{0.2, 0.1}};
  for (int k = 1; k <= 10; ++k) ASSERT_TRUE(filter.update(fix(2.0 * k + (k % 3), k - (k % 2)), at(k)).accepted());
  ASSERT_TRUE(filter.update(fix(9, 4), at(4)).accepted());  // a second one of the same epoch
  ASSERT_EQ(filter.smooth(), SmoothStatus::kDone);
  ASSERT_EQ(filter.smoothed().size(), 11u);
  EXPECT_EQ(filter.smoothed().back().state.x, filter.state().x);
  EXPECT_EQ(filter.smoothed_epochs()[3], at(4));
  EXPECT_EQ(filter.smoothed_epochs()[4], at(4));
  EXPECT_LT((filter.smoothed()[3].state.x - filter.smoothed()[4].state.x).norm(), 1e-9);
  EXPECT_LT((filter.smoothed()[3].P - filter.smoothed()[4].P).norm(), 1e-9);
  RtsSmoother<Vehicle> smoother(11);
  ExtendedKalmanFilter<Vehicle> plain(test::vehicle(0, 0, 2, 1), Eigen::Matrix4d::Identity());
  for (int k = 1; k <= 10; ++k) {
    StepRecord<Vehicle> record;
    ASSERT_EQ(plain.predict(motion, 1.0, &record.cross), UpdateStatus::kAccepted);
    record.predicted = plain.state();
    record.P_pred = plain.covariance();
    ASSERT_TRUE(plain.update(fix(2.0 * k + (k % 3), k - (k % 2))).accepted());
    if (k == 4) {
      ASSERT_TRUE(plain.update(fix(9, 4)).accepted());
    }
    record.filtered = plain.state();
    record.P = plain.covariance();
    ASSERT_EQ(smoother.record(record), SmoothStatus::kDone);
  }
  ASSERT_EQ(smoother.smooth(), SmoothStatus::kDone);
  EXPECT_LT((filter.smoothed()[0].state.x - smoother.smoothed()[0].state.x).norm(), 1e-9);
  EXPECT_LT((filter.smoothed()[0].P - smoother.smoothed()[0].P).norm(), 1e-9);
}

TEST(FixedLagFilter, GoesOnFromItsMemoryToTheBit) {
  Lagged filter = lagged(6);
  const Gate gate{.nis = 30.0};
  for (int k = 1; k <= 9; ++k) {
    const double off = k == 8 ? 90.0 : 0.3 * (k % 3);
    static_cast<void>(filter.update(fix(2.0 * k + off, k), at(k), gate));
  }
  ASSERT_EQ(filter.advance(at(9.5)), UpdateStatus::kAccepted);
  auto memory = filter.memory();
  ASSERT_EQ(memory.arrivals.size(), 6u);
  Lagged again(Motion{{0.2, 0.1}}, memory);
  EXPECT_EQ(again.state().x, filter.state().x);
  EXPECT_EQ(again.covariance(), filter.covariance());
  EXPECT_EQ(again.epoch(), filter.epoch());
  EXPECT_EQ(again.oldest_epoch(), filter.oldest_epoch());
  for (Lagged* each : {&filter, &again}) {
    EXPECT_TRUE(each->update(fix(13, 6.4), at(6.5)).accepted());
    EXPECT_EQ(each->update(fix(8, 4), at(3.9)).status, UpdateStatus::kTooLate);
  }
  EXPECT_EQ(again.state().x, filter.state().x);
  std::swap(memory.arrivals[1].epoch, memory.arrivals[2].epoch);
  EXPECT_THROW(Lagged(Motion{}, memory), std::invalid_argument);
  memory.capacity = 2;
  EXPECT_THROW(Lagged(Motion{}, memory), std::invalid_argument);
}

TEST(FixedLagFilter, SetUpThatIsNone) {
  EXPECT_THROW(lagged(0), std::invalid_argument);
  EXPECT_NO_THROW(lagged(1));
  EXPECT_THROW(Lagged(ExtendedKalmanFilter<Vehicle>({}, Eigen::Matrix4d::Identity()), Motion{},
                      Epoch::invalid(TimeScale::kGps), 3),
               std::invalid_argument);
}

// Throws where it is asked to.
struct Throwing {
  using Frame = PlanarFrame;
  static constexpr int kDim = 2;
  bool now = false;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    if (now) throw std::runtime_error("of a model");
    return Fix{}.predict(x, y);
  }
};

TEST(FixedLagFilter, AnExceptionOfAModelLeavesItAsItWas) {
  FixedLagFilter<ExtendedKalmanFilter<Vehicle>, Motion, Throwing> filter(
      ExtendedKalmanFilter<Vehicle>(test::vehicle(0, 0, 2, 1), Eigen::Matrix4d::Identity()), Motion{{0.2, 0.1}}, at(0),
      3);
  const auto observed = [](double x, double y, bool now) {
    return Observed<Throwing>(Throwing{now}, Eigen::Vector2d(x, y), Eigen::Matrix2d::Identity());
  };
  for (int k = 1; k <= 5; ++k) ASSERT_TRUE(filter.update(observed(2.0 * k, k, false), at(k)).accepted());
  const auto before = filter.state().x;
  EXPECT_THROW(static_cast<void>(filter.update(observed(8, 4, true), at(4.5))), std::runtime_error);
  EXPECT_EQ(filter.state().x, before);
  EXPECT_EQ(filter.size(), 3);
  EXPECT_TRUE(filter.update(observed(12, 6, false), at(6)).accepted());
}

}  // namespace
}  // namespace soopnav

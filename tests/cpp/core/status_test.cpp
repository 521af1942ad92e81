#include "soopnav/core/status.hpp"

#include <gtest/gtest.h>

#include <set>
#include <string_view>

namespace soopnav {
namespace {

TEST(UpdateStatus, EveryStatusHasAPhraseOfItsOwn) {
  std::set<std::string_view> phrases;
  const UpdateStatus all[] = {UpdateStatus::kAccepted,
                              UpdateStatus::kGated,
                              UpdateStatus::kUndefined,
                              UpdateStatus::kNonFinite,
                              UpdateStatus::kNotPositiveDefinite,
                              UpdateStatus::kStaleHandle,
                              UpdateStatus::kWrongTimeScale,
                              UpdateStatus::kTimeNotAdvancing,
                              UpdateStatus::kTooLate,
                              UpdateStatus::kTooManyRows};
  for (const UpdateStatus status : all) {
    EXPECT_NE(to_string(status), "unknown");
    phrases.insert(to_string(status));
  }
  EXPECT_EQ(phrases.size(), std::size(all));
  EXPECT_EQ(to_string(UpdateStatus::kAccepted), "accepted");
  EXPECT_EQ(to_string(UpdateStatus::kNotPositiveDefinite), "not positive definite");
  EXPECT_EQ(to_string(static_cast<UpdateStatus>(250)), "unknown");
}

}  // namespace
}  // namespace soopnav

// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// That calls are refused, and what is said of them.
#pragma once

#include <gtest/gtest.h>

#include <stdexcept>
#include <string>

namespace ndtree::test {

/// What a call is refused with, or "accepted".
template <class Error = std::invalid_argument, class Call>
std::string refusal_by(const Call& call) {
  try {
    call();
  } catch (const Error& error) {
    return error.what();
  }
  return "accepted";
}

/// That a call is refused with words in its message.
template <class Error = std::invalid_argument, class Call>
void expect_refused(const Call& call, const std::string& said) {
  const std::string found = refusal_by<Error>(call);
  EXPECT_NE(found.find(said), std::string::npos) << found;
}

}  // namespace ndtree::test

// SPDX-License-Identifier: GPL-3.0-or-later
// Counts every allocation of the program, where the C library lets us: the GNU one, without a sanitizer that does the same.
#include <doctest/doctest.h>

#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__)

#include <omp.h>

#include <atomic>
#include <cstddef>

#include "bfloat16_unit.hpp"
#include "emulator/plain_newton.hpp"
#include "emulator/random_network.hpp"
#include "followthrough/emulator/patch_newton.hpp"

namespace {

std::atomic<long> allocations{0};

}  // namespace

extern "C" {
void* __libc_malloc(std::size_t size);                           // NOLINT: its name in the C library
void* __libc_memalign(std::size_t alignment, std::size_t size);  // NOLINT
void* malloc(std::size_t size) noexcept {
  ++allocations;
  return __libc_malloc(size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) noexcept {
  ++allocations;
  return __libc_memalign(alignment, size);
}
}

using namespace followthrough;

TEST_CASE("a step of the patch network allocates nothing") {
  const int threads = omp_get_max_threads();
  omp_set_num_threads(1);
  const EmulatedBody body = block_of_cubes(6, 3, 3);
  const Bfloat16Unit usual_unit = bfloat16_unit();
  std::vector<Bfloat16Unit> units = available_bfloat16_units();
  units.push_back(Bfloat16Unit::none);
  for (const Bfloat16Unit unit : units) {
    use_bfloat16_unit(unit);
    const Precision precision = unit == Bfloat16Unit::none ? Precision::float32 : Precision::bfloat16;
    Emulator solver(body, random_network(2), {}, precision);
    std::vector<Positions> motion;
    for (int frame = 0; frame < 8; ++frame) motion.push_back(swinging(body.rest_positions, frame));
    solver.reset(motion[0]);
    const long before = allocations;
    for (const Positions& reference : motion) solver.step(reference);
    CHECK(allocations == before);
  }
  use_bfloat16_unit(usual_unit);
  omp_set_num_threads(threads);
}

TEST_CASE("a step of guided Newton passes allocates nothing") {
  const int threads = omp_get_max_threads();
  omp_set_num_threads(1);
  const NewtonBody body{block_of_cubes(6, 3, 3)};
  NewtonSchedule schedule = random_schedule(2, {{4, true, {32, 32}}, {3, true, {16}}});
  schedule.extra_passes = 2;
  PatchNewton solver(body, schedule);
  std::vector<Positions> motion;
  for (int frame = 0; frame < 8; ++frame) motion.push_back(swinging(body.rest_positions, frame));
  motion[5] *= -1.0;  // stretches below the clamp
  const long before_reset = allocations;
  solver.reset(motion[0]);
  CHECK(allocations > before_reset);  // the count works
  const long before = allocations;
  for (const Positions& reference : motion) solver.step(reference);
  CHECK(allocations == before);
  omp_set_num_threads(threads);
}

#endif

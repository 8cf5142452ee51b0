// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/emulator/emulator.hpp"

#include <doctest/doctest.h>
#include <omp.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "bfloat16_unit.hpp"
#include "emulator/patch_kernel.hpp"
#include "emulator/plain_emulator.hpp"
#include "emulator/random_network.hpp"
#include "followthrough/errors.hpp"
#include "instruction_set.hpp"
#include "runs.hpp"

using namespace followthrough;

namespace {

std::vector<Positions> run(Emulator& emulator, const Positions& rest, int frames) {
  emulator.reset(swinging(rest, 0));
  std::vector<Positions> result;
  for (int frame = 1; frame <= frames; ++frame) result.push_back(emulator.step(swinging(rest, frame)));
  return result;
}

Vector lumped_mass(const EmulatedBody& body) {
  Vector mass = Vector::Zero(body.rest_positions.rows());
  const double edge = body.rest_positions(1, 2) - body.rest_positions(0, 2);
  for (Eigen::Index t = 0; t < body.tets.rows(); ++t) {
    for (int k = 0; k < 4; ++k) mass[body.tets(t, k)] += 1000.0 * edge * edge * edge / 24.0;
  }
  return mass;
}

double difference(const std::vector<Positions>& a, const std::vector<Positions>& b) {
  double largest = 0.0;
  for (std::size_t f = 0; f < a.size(); ++f) largest = std::max(largest, (a[f] - b[f]).cwiseAbs().maxCoeff());
  return largest;
}

// The published one and variants: without reference motion, without biases, of odd widths and depths, with more rings.
std::vector<Architecture> all_architectures() {
  std::vector<Architecture> architectures(7);
  architectures[1].sees_reference = false;
  architectures[2].biases = false;
  architectures[3] = {{20, 7}, {33, 5}, {17}, 2, true, true};
  architectures[4] = {{8, 24, 40}, {50, 16, 100, 9}, {70, 31, 1}, 3, false, false};
  architectures[5] = {{16, 16}, {48, 48, 48}, {96, 80}, 3, true, true};
  architectures[6] = {{300, 1}, {1, 200, 3}, {1}, 1, true, true};
  return architectures;
}

struct UsualUnit {
  Bfloat16Unit unit = bfloat16_unit();
  ~UsualUnit() { use_bfloat16_unit(unit); }
};

}  // namespace

TEST_CASE("the emulator is the plain network, with every architecture and instruction set") {
  const Usual usual;
  const std::vector<Architecture> architectures = all_architectures();
  for (std::size_t a = 0; a < architectures.size(); ++a) {
    CAPTURE(a);
    const PatchNetwork network = random_network(static_cast<unsigned>(a), architectures[a]);
    const EmulatedBody body = block_of_cubes(3, 2, 2);
    PlainEmulator plain(body.rest_positions, body.tets, body.constrained, body.youngs_modulus * 1e-6, lumped_mass(body), network);
    plain.reset(swinging(body.rest_positions, 0));
    std::vector<Positions> expected;
    for (int frame = 1; frame <= 4; ++frame) expected.push_back(plain.step(swinging(body.rest_positions, frame)));
    double moved = 0.0;
    for (int frame = 1; frame <= 4; ++frame) {
      moved = std::max(
          moved, (expected[static_cast<std::size_t>(frame) - 1] - swinging(body.rest_positions, frame)).cwiseAbs().maxCoeff());
    }
    CHECK(moved > 0.01);
    std::vector<Positions> fused;
    for (const InstructionSet set : available_instruction_sets()) {
      CAPTURE(name_of(set));
      use_instruction_set(set);
      Emulator emulator(body, network);
      const std::vector<Positions> result = run(emulator, body.rest_positions, 4);
      CHECK(difference(result, expected) < 1e-6);
      if (set != InstructionSet::baseline) {  // sets with fused multiply-adds agree to the bit
        for (std::size_t f = 0; f < fused.size(); ++f) CHECK(same_bits(result[f], fused[f]));
        fused = result;
      }
    }
  }
}

TEST_CASE("in bfloat16 the emulator is the plain network with rounded numbers, on every unit") {
  const UsualUnit usual;
  const EmulatedBody body = block_of_cubes(3, 2, 2);
  std::vector<Architecture> architectures = all_architectures();
  architectures.push_back({{40, 64, 33, 20}, {64, 32, 16, 48, 20}, {100, 64, 130}, 2, true, true});
  architectures.push_back({{40, 50, 33}, {64, 70, 16}, {100, 90}, 2, true, true});
  for (std::size_t a = 0; a < architectures.size(); ++a) {
    CAPTURE(a);
    const PatchNetwork network = random_network(static_cast<unsigned>(a), architectures[a]);
    const auto plain = [&](Precision precision) {
      PlainEmulator emulator(body.rest_positions, body.tets, body.constrained, body.youngs_modulus * 1e-6, lumped_mass(body),
                             network, precision);
      emulator.reset(swinging(body.rest_positions, 0));
      return Positions(emulator.step(swinging(body.rest_positions, 1)));
    };
    const Positions exact = plain(Precision::float32), rounded = plain(Precision::bfloat16);
    for (const Bfloat16Unit unit : available_bfloat16_units()) {
      CAPTURE(static_cast<int>(unit));
      use_bfloat16_unit(unit);
      Emulator emulator(body, network, {}, Precision::bfloat16);
      const Positions result = run(emulator, body.rest_positions, 1).front();
      // Where a number is near to halfway between two of bfloat16, the last bits decide which it becomes, and later layers amplify
      // that.
      const Architecture& widths = architectures[a];
      const bool deep = std::max({widths.inertia.size(), widths.force.size(), widths.displacement.size() + 1}) > 3;
      CHECK((result - rounded).norm() < (deep ? 0.9 : 0.35) * (rounded - exact).norm() + 1e-5);
      CHECK((result - exact).norm() < 0.01 * (exact - swinging(body.rest_positions, 1)).norm());
    }
  }
}

TEST_CASE("bfloat16 is refused where no unit is faster than single precision") {
  const UsualUnit usual;
  use_bfloat16_unit(Bfloat16Unit::none);
  CHECK_THROWS_WITH_AS(Emulator(block_of_cubes(3, 2, 2), random_network(0), {}, Precision::bfloat16), doctest::Contains("AMX"),
                       InvalidInput);
  const std::vector<Bfloat16Unit> units = available_bfloat16_units();
  for (const Bfloat16Unit unit : {Bfloat16Unit::pairs, Bfloat16Unit::tiles}) {
    if (std::find(units.begin(), units.end(), unit) == units.end()) CHECK_THROWS_AS(use_bfloat16_unit(unit), InvalidInput);
  }
}

TEST_CASE("the emulator does not depend on the number of threads") {
  const Usual usual;
  const EmulatedBody body = block_of_cubes(9, 9, 8);
  Architecture architecture;
  architecture.force = {64, 48, 64};
  architecture.rings = 2;
  const PatchNetwork network = random_network(1, architecture);
  const UsualUnit usual_unit;
  std::vector<Bfloat16Unit> units = available_bfloat16_units();
  units.push_back(Bfloat16Unit::none);
  for (const Bfloat16Unit unit : units) {
    use_bfloat16_unit(unit);
    const Precision precision = unit == Bfloat16Unit::none ? Precision::float32 : Precision::bfloat16;
    std::vector<Positions> first;
    for (const int threads : {1, 2, 3, 4}) {
      omp_set_num_threads(threads);
      Emulator emulator(body, network, {}, precision);
      const std::vector<Positions> result = run(emulator, body.rest_positions, 2);
      if (first.empty()) first = result;
      for (std::size_t f = 0; f < result.size(); ++f) CHECK(same_bits(result[f], first[f]));
    }
  }
}

TEST_CASE("tanh is off by less than 5e-7, odd, exact at zero and keeps what is not a number") {
  const Usual usual;
  std::vector<float> in, out;
  for (int k = -400000; k <= 400000; ++k) in.push_back(static_cast<float>(k) * 3e-5f);
  for (const float x : {1e-30f, 1e-12f, 1e-4f, 15.0f, 1e6f, 1e30f, std::numeric_limits<float>::infinity()}) {
    in.push_back(x);
    in.push_back(-x);
  }
  in.push_back(std::numeric_limits<float>::quiet_NaN());
  out.resize(in.size());
  for (const InstructionSet set : available_instruction_sets()) {
    CAPTURE(name_of(set));
    auto* const rational_tanh = set == InstructionSet::baseline ? baseline::rational_tanh
#ifdef FOLLOWTHROUGH_HAS_avx512
                                : set == InstructionSet::avx512 ? avx512::rational_tanh
                                : set == InstructionSet::avx2   ? avx2::rational_tanh
#endif
                                                              : baseline::rational_tanh;
    rational_tanh(in.data(), out.data(), static_cast<std::int64_t>(in.size()));
    double absolute = 0.0, relative = 0.0;
    for (std::size_t k = 0; k + 1 < in.size(); ++k) {
      const double exact = std::tanh(static_cast<double>(in[k]));
      const double off = std::abs(static_cast<double>(out[k]) - exact);
      absolute = std::max(absolute, off);
      if (exact != 0.0) relative = std::max(relative, off / std::abs(exact));
    }
    CHECK(absolute < 5e-7);
    CHECK(relative < 5e-7);
    CHECK(out[400000] == 0.0f);
    CHECK(out[0] == -out[800000]);
    CHECK(std::isnan(out.back()));
  }
}

TEST_CASE("bfloat16's tanh is off by less than a tenth of its rounding, odd, within 1, and keeps what is not a number") {
  std::vector<float> in, out;  // rising
  for (int k = -400000; k < 400000; ++k) in.push_back((static_cast<float>(k) + 0.5f) * 3e-5f);
  for (const float x : {1e6f, 1e30f, std::numeric_limits<float>::infinity()}) in.push_back(x);
  in.resize(in.size() + 16 - in.size() % 16, std::numeric_limits<float>::quiet_NaN());
  out.resize(in.size());
  for (const Bfloat16Unit unit : available_bfloat16_units()) {
    CAPTURE(static_cast<int>(unit));
    auto* near_tanh = static_cast<void (*)(const float*, float*, std::int64_t) noexcept>(nullptr);
#ifdef FOLLOWTHROUGH_HAS_amx
    if (unit == Bfloat16Unit::tiles) near_tanh = amx::near_tanh;
#endif
#ifdef FOLLOWTHROUGH_HAS_avx512_bf16
    if (unit == Bfloat16Unit::pairs) near_tanh = avx512_bf16::near_tanh;
#endif
    REQUIRE((near_tanh != nullptr));
    near_tanh(in.data(), out.data(), static_cast<std::int64_t>(in.size()));
    double absolute = 0.0, relative = 0.0, fall = 0.0, odd = 0.0;
    for (std::size_t k = 0; k < 800003; ++k) {
      const double exact = std::tanh(static_cast<double>(in[k])), off = std::abs(static_cast<double>(out[k]) - exact);
      absolute = std::max(absolute, off);
      relative = std::max(relative, off / std::abs(exact));
      if (k > 0) fall = std::max(fall, static_cast<double>(out[k - 1]) - static_cast<double>(out[k]));
      if (k < 800000) odd = std::max(odd, std::abs(static_cast<double>(out[k]) + static_cast<double>(out[799999 - k])));
    }
    CHECK(absolute < 2.1e-4);
    CHECK(relative < 2.3e-4);
    CHECK(fall < 2e-7);  // single precision's own rounding
    CHECK(odd == 0.0);
    CHECK(out[800002] <= 1.0f);
    CHECK(std::isnan(out.back()));
  }
}

TEST_CASE("a scene in other units gives the same motion in those units") {
  const PatchNetwork network = random_network(2);
  const EmulatedBody body = block_of_cubes(3, 2, 2);
  Emulator emulator(body, network);
  CHECK(emulator.edge_length() == doctest::Approx(0.2).epsilon(1e-12));
  CHECK(emulator.stiffness()[0] == doctest::Approx(1.25).epsilon(1e-12));
  const std::vector<Positions> expected = run(emulator, body.rest_positions, 8);
  for (const double size : {0.01, 100.0}) {
    for (const double slowness : {0.5, 3.0}) {
      for (const double weight : {0.2, 7.0}) {
        CAPTURE(size);
        EmulatedBody other = body;
        other.rest_positions *= size;
        other.dt *= slowness;
        other.density *= weight;
        other.youngs_modulus *= weight * size * size / (slowness * slowness);
        Emulator scaled(other, network);
        CHECK((scaled.stiffness() - emulator.stiffness()).cwiseAbs().maxCoeff() < 1e-9);
        scaled.reset(swinging(body.rest_positions, 0) * size);
        double off = 0.0;
        for (int frame = 1; frame <= 8; ++frame) {
          const Positions result = scaled.step(swinging(body.rest_positions, frame) * size) / size;
          off = std::max(off, (result - expected[static_cast<std::size_t>(frame) - 1]).cwiseAbs().maxCoeff());
        }
        CHECK(off < 1e-6);
      }
    }
  }
}

TEST_CASE("a scene far away, and vertices in another order, give the same motion") {
  const PatchNetwork network = random_network(3);
  const EmulatedBody body = block_of_cubes(3, 2, 2);
  Emulator emulator(body, network);
  const std::vector<Positions> expected = run(emulator, body.rest_positions, 8);
  emulator.reset(swinging(body.rest_positions, 0).array() + 4096.0);
  for (int frame = 1; frame <= 8; ++frame) {
    const Positions result = emulator.step(swinging(body.rest_positions, frame).array() + 4096.0);
    CHECK((result.array() - 4096.0 - expected[static_cast<std::size_t>(frame) - 1].array()).abs().maxCoeff() < 1e-6);
  }
  const Index count = static_cast<Index>(body.rest_positions.rows());
  EmulatedBody mirrored = body;  // vertex v is now count - 1 - v
  mirrored.rest_positions = body.rest_positions.colwise().reverse().eval();
  mirrored.tets = (count - 1 - body.tets.array()).matrix();
  mirrored.constrained = body.constrained.reverse().eval();
  mirrored.youngs_modulus = body.youngs_modulus.reverse().eval();
  Emulator other(mirrored, network);
  const std::vector<Positions> result = run(other, mirrored.rest_positions, 8);
  for (std::size_t f = 0; f < result.size(); ++f) {
    CHECK((result[f].colwise().reverse() - expected[f]).cwiseAbs().maxCoeff() < 1e-6);
  }
}

TEST_CASE("constrained vertices are on the reference, and a state resumes the run bit for bit") {
  const EmulatedBody body = block_of_cubes(4, 2, 2);
  const PatchNetwork network = random_network(4);
  Emulator emulator(body, network);
  const std::vector<Positions> expected = run(emulator, body.rest_positions, 10);
  for (int frame = 1; frame <= 10; ++frame) {
    const Positions reference = swinging(body.rest_positions, frame);
    for (Eigen::Index v = 0; v < reference.rows(); ++v) {
      if (body.constrained[v]) CHECK(expected[static_cast<std::size_t>(frame) - 1].row(v) == reference.row(v));
    }
  }
  emulator.reset(swinging(body.rest_positions, 0));
  for (int frame = 1; frame <= 5; ++frame) emulator.step(swinging(body.rest_positions, frame));
  const SolverState state = emulator.state();
  Emulator other(body, network);
  for (Emulator* resumed : {&emulator, &other}) {
    resumed->restore(state);
    for (int frame = 6; frame <= 10; ++frame) {
      CHECK(same_bits(resumed->step(swinging(body.rest_positions, frame)), expected[static_cast<std::size_t>(frame) - 1]));
    }
  }
}

TEST_CASE("a network without biases leaves a resting body at rest") {
  Architecture architecture;
  architecture.biases = false;
  PatchNetwork network = random_network(5, architecture);
  // Without material, which is not zero at rest, nothing is left that could move anything.
  network.inertia.front().weight.rightCols(3).setZero();
  network.forces[0].front().weight.rightCols(3).setZero();
  network.forces[0].front().weight.col(0).setZero();
  const EmulatedBody body = block_of_cubes(3, 3, 3);
  Emulator emulator(body, network);
  emulator.reset(body.rest_positions);
  for (int frame = 0; frame < 5; ++frame) CHECK(same_bits(emulator.step(body.rest_positions), body.rest_positions));
}

TEST_CASE("what does not fit is refused by name, and leaves the state as it was") {
  const EmulatedBody body = block_of_cubes(2, 1, 1);
  const PatchNetwork network = random_network(6);
  const auto refused = [](const auto& make, const char* name) {
    try {
      make();
      FAIL("expected a complaint about " << name);
    } catch (const InvalidInput& error) {
      CHECK(error.argument() == name);
    }
  };
  const auto with_network = [&](const auto& change) {
    PatchNetwork changed = network;
    change(changed);
    return [&body, changed] { Emulator(body, changed); };
  };
  refused(with_network([](PatchNetwork& n) {
            n.inertia.pop_back();
            n.inertia.resize(1);
          }),
          "point_mlp");
  refused(with_network([](PatchNetwork& n) { n.inertia.clear(); }), "point_mlp");
  refused(with_network([](PatchNetwork& n) { n.forces.clear(); }), "edge_mlp");
  refused(with_network([](PatchNetwork& n) { n.inertia[0].weight.resize(64, 12); }), "point_mlp.0.weight");
  refused(with_network([](PatchNetwork& n) { n.forces[0][1].weight.setZero(128, 127); }), "edge_mlp.2.weight");
  refused(with_network([](PatchNetwork& n) { n.forces[0][4].bias.setZero(5); }), "edge_mlp.8.bias");
  refused(with_network([](PatchNetwork& n) { n.forces.push_back(n.forces[0]); }), "instance_mlp.0.weight");
  refused(with_network([](PatchNetwork& n) { n.displacement.pop_back(); }), "instance_mlp");
  refused(with_network([](PatchNetwork& n) { n.displacement[2].weight(3, 4) = NAN; }), "instance_mlp.4.weight");
  const auto with_body = [&](const auto& change) {
    EmulatedBody changed = body;
    change(changed);
    return [&network, changed] { Emulator(changed, network); };
  };
  refused(with_body([](EmulatedBody& b) { b.tets(3, 1) = 99; }), "tets");
  refused(with_body([](EmulatedBody& b) { b.tets.conservativeResize(1, 4); }), "tets");
  refused(with_body([](EmulatedBody& b) { b.tets.resize(0, 4); }), "tets");
  refused(with_body([](EmulatedBody& b) { b.rest_positions(2, 1) = INFINITY; }), "rest_positions");
  refused(with_body([](EmulatedBody& b) { b.youngs_modulus[3] = 0.0; }), "youngs_modulus");
  refused(with_body([](EmulatedBody& b) { b.density.resize(2); }), "density");
  refused(with_body([](EmulatedBody& b) { b.constrained.resize(2); }), "constrained");
  refused(with_body([](EmulatedBody& b) { b.dt = NAN; }), "dt");
  refused(with_body([](EmulatedBody& b) { b.edge_length = -1.0; }), "edge_length");

  Emulator emulator(body, network);
  refused([&] { emulator.step(body.rest_positions); }, "reference");
  emulator.reset(body.rest_positions);
  const Positions first = emulator.step(swinging(body.rest_positions, 1));
  const SolverState state = emulator.state();
  Positions broken = body.rest_positions;
  broken(1, 1) = NAN;
  refused([&] { emulator.step(broken); }, "reference");
  refused([&] { emulator.step(broken.topRows(3)); }, "reference");
  refused([&] { emulator.reset(broken); }, "reference");
  SolverState foreign = state;
  foreign.arrays.pop_back();
  refused([&] { emulator.restore(foreign); }, "state");
  const SolverState after = emulator.state();
  CHECK(after.counters == state.counters);
  for (std::size_t k = 0; k < state.arrays.size(); ++k) CHECK(same_bits(after.arrays[k], state.arrays[k]));
}

TEST_CASE("with gravity a network sees its scene from a frame of reference that falls") {
  const EmulatedBody plain = block_of_cubes(3, 2, 2);
  EmulatedBody heavy = plain;
  heavy.gravity << 1.0, 0.0, -9.81;
  const Eigen::RowVector3d fall = 0.5 * plain.dt * plain.dt * heavy.gravity.transpose();
  const Positions rest = plain.rest_positions;
  const auto seen = [&](Positions positions, double frames) {  // so many frames from now
    positions.rowwise() -= frames * frames * fall;
    return positions;
  };
  for (const bool sees_reference : {true, false}) {
    CAPTURE(sees_reference);
    const PatchNetwork network = random_network(7, {{16, 16}, {24, 16}, {24}, 1, sees_reference, true});
    Emulator here(heavy, network), falling(plain, network);
    here.reset(rest);
    double moved = 0;
    for (int frame = 1; frame <= 8; ++frame) {
      SolverState state = here.state();
      state.arrays[1] = seen(state.arrays[1], -1);
      state.arrays[2] = seen(state.arrays[2], -2);
      state.arrays[4] = seen(state.arrays[4], -1);
      falling.restore(state);
      const Positions& there = falling.step(seen(swinging(rest, frame), 1));
      const Positions& result = here.step(swinging(rest, frame));
      CHECK((seen(result, 1) - there).cwiseAbs().maxCoeff() < 1e-6);
      for (Eigen::Index v = 0; v < rest.rows(); ++v) {
        if (plain.constrained[v]) CHECK(result.row(v) == swinging(rest, frame).row(v));
      }
      moved = std::max(moved, (result - swinging(rest, frame)).cwiseAbs().maxCoeff());
    }
    CHECK(moved > 0.01);
  }
}

TEST_CASE("a network that has learned nothing but inertia falls as backward Euler does") {
  constexpr float small = 1e-2f;  // where a tanh is linear
  PatchNetwork network = random_network(0, {{3, 3}, {1, 1}, {3}, 1, true, false});
  network.inertia[0].weight.setZero();
  for (int axis = 0; axis < 3; ++axis) {
    network.inertia[0].weight(axis, axis) = small;       // u(t) ...
    network.inertia[0].weight(axis, 3 + axis) = -small;  // ... - u(t-1)
  }
  network.inertia[1].weight.setIdentity();
  network.forces[0][0].weight.setZero();
  network.displacement[0].weight.setIdentity();
  network.displacement[1].weight = Eigen::Matrix3f::Identity() / small;
  EmulatedBody body = block_of_cubes(3, 2, 2, 0.05);
  body.gravity << 0.3, 0.0, -9.81;
  Emulator emulator(body, network);
  emulator.reset(body.rest_positions);
  for (int frame = 1; frame <= 6; ++frame) {
    const Positions& positions = emulator.step(body.rest_positions);
    // u(t+1) = 2 u(t) - u(t-1) + h^2 g
    const Eigen::RowVector3d expected = 0.5 * frame * (frame + 1) * body.dt * body.dt * body.gravity.transpose();
    for (Eigen::Index v = 0; v < positions.rows(); ++v) {
      const Eigen::RowVector3d fallen = positions.row(v) - body.rest_positions.row(v);
      CHECK((fallen - (body.constrained[v] ? Eigen::RowVector3d(0.0, 0.0, 0.0) : expected)).norm() < 1e-3 * expected.norm());
    }
  }
}

// SPDX-License-Identifier: GPL-3.0-or-later
#include "springs/constants_search.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace followthrough {
namespace {

// Constants that are kept to, 1/s^2 and 1/s.
LogConstants lowest() { return {std::log(1e-6), std::log(1e-6)}; }
LogConstants highest() { return {std::log(1e12), std::log(1e9)}; }
// What decides where the motion does not: a pull to the usual constants, of the logarithms' squares, as a share of the motion.
constexpr double least_pull = 1e-10;
LogConstants usual() { return {std::log(usual_stiffness), std::log(usual_damping)}; }

constexpr int most_steps = 60;
constexpr double enough = 1e-9;  // of the logarithms
constexpr int smooth_steps = 12;
constexpr std::size_t most_starts = 4;
constexpr int first_steps = 4;
constexpr double distance_apart = 0.3;  // of log ks

// Where the genetic algorithm begins: ks dt^2, and the damping ratio, logarithms.
const double least_rate = std::log(1e-5), greatest_rate = std::log(1e4);
const double least_ratio = std::log(2e-3), greatest_ratio = std::log(300.0);

LogConstants clamped(const LogConstants& constants) { return constants.cwiseMax(lowest()).cwiseMin(highest()); }

LossGradient with_pull(LossGradient sums, const LogConstants& at, double strength) {
  sums.loss += strength * (at - usual()).squaredNorm();
  sums.gradient += 2.0 * strength * (at - usual());
  sums.curvature.diagonal().array() += 2.0 * strength;
  return sums;
}

// Levenberg-Marquardt within bounds.
template <typename Function>
Found minimize(const Function& function, LogConstants at, int steps) {
  const LogConstants least = lowest(), greatest = highest();
  at = clamped(at);
  LossGradient here = function(at);
  double damping = 1e-3;
  for (int step = 0; step < steps; ++step) {
    Eigen::Matrix2d curvature = here.curvature;
    Eigen::Vector2d gradient = here.gradient;
    for (int k = 0; k < 2; ++k) {  // a bound that holds leaves the other constant to move alone
      if ((at[k] <= least[k] && gradient[k] > 0.0) || (at[k] >= greatest[k] && gradient[k] < 0.0)) {
        curvature(0, 1) = curvature(1, 0) = 0.0;
        gradient[k] = 0.0;
      }
    }
    bool better = false;
    while (!better && damping < 1e12) {
      Eigen::Matrix2d system = curvature;
      system.diagonal() += damping * curvature.diagonal();
      system.diagonal().array() += std::numeric_limits<double>::min();
      const double determinant = system(0, 0) * system(1, 1) - system(0, 1) * system(1, 0);
      LogConstants change;
      if (determinant > 1e-14 * system(0, 0) * system(1, 1)) {
        change[0] = -(system(1, 1) * gradient[0] - system(0, 1) * gradient[1]) / determinant;
        change[1] = -(system(0, 0) * gradient[1] - system(1, 0) * gradient[0]) / determinant;
      } else {
        change = -gradient.cwiseQuotient(2.0 * system.diagonal());
      }
      const double longest = change.cwiseAbs().maxCoeff();
      if (!std::isfinite(longest)) {
        return {at, here.loss};
      }
      if (longest > 2.0) {
        change *= 2.0 / longest;
      }
      const LogConstants next = clamped(at + change);
      const LossGradient there = function(next);
      better = there.loss < here.loss;
      const bool small = (next - at).cwiseAbs().maxCoeff() < enough;
      if (better) {
        at = next;
        here = there;
        damping = std::max(damping / 8.0, 1e-12);
      } else {
        damping *= 6.0;
      }
      if (small) {
        return {at, here.loss};
      }
    }
    if (!better) {
      break;
    }
  }
  return {at, here.loss};
}

// Standard normal, by Box and Muller.
double normal(VertexRandom& random) {
  const double radius = std::sqrt(-2.0 * std::log(1.0 - random.uniform()));
  return radius * std::cos(2.0 * std::numbers::pi * random.uniform());
}

class Population {
 public:
  Population(double dt, int size, VertexRandom& random) : members_(static_cast<std::size_t>(size)), random_(random) {
    // One member in every cell of a grid, so that small populations reach everywhere.
    const int columns = std::max(1, static_cast<int>(std::lround(std::sqrt(1.5 * size))));
    const int rows = (size + columns - 1) / columns;
    for (int i = 0; i < size; ++i) {
      const double across = (i % columns + random_.uniform()) / columns, along = (i / columns + random_.uniform()) / rows;
      const double rate = std::lerp(least_rate, greatest_rate, across), ratio = std::lerp(least_ratio, greatest_ratio, along);
      const double stiffness = rate - 2.0 * std::log(dt);
      members_[static_cast<std::size_t>(i)].constants = {stiffness, std::numbers::ln2 + ratio + 0.5 * stiffness};
    }
  }

  template <typename Function>
  void judge(const Function& value) {
    for (std::size_t i = kept_; i < members_.size(); ++i) {
      members_[i].constants = clamped(members_[i].constants);
      members_[i].value = value(members_[i].constants);
    }
    // Equal values keep their order, so that the result is one and the same everywhere.
    std::stable_sort(members_.begin(), members_.end(), [](const Found& a, const Found& b) { return a.value < b.value; });
  }

  // Replaces the worst; judged again with the next generation.
  void invite(const Found& guest) {
    members_.back() = guest;
    std::stable_sort(members_.begin(), members_.end(), [](const Found& a, const Found& b) { return a.value < b.value; });
  }

  void breed(double spread) {
    kept_ = std::max<std::size_t>(2, members_.size() / 6);
    const std::vector<Found> parents = members_;
    for (std::size_t i = kept_; i < members_.size(); ++i) {
      const LogConstants &mother = chosen(parents), &father = chosen(parents);
      for (int gene = 0; gene < 2; ++gene) {
        const double share = std::lerp(-0.25, 1.25, random_.uniform());
        members_[i].constants[gene] = std::lerp(mother[gene], father[gene], share) + spread * normal(random_);
      }
    }
  }

  const Found& best() const { return members_.front(); }

  // The best, and the best of those that are not near a better one.
  std::vector<Found> apart(std::size_t most) const {
    std::vector<Found> chosen;
    for (const Found& member : members_) {
      const bool near = std::any_of(chosen.begin(), chosen.end(), [&](const Found& other) {
        return std::abs(other.constants[0] - member.constants[0]) < distance_apart;
      });
      if (!near && chosen.size() < most) {
        chosen.push_back(member);
      }
    }
    return chosen;
  }

 private:
  // The better of two: sorted, the one of the lower place.
  const LogConstants& chosen(const std::vector<Found>& parents) {
    const auto place = [&] {
      return std::min(parents.size() - 1, static_cast<std::size_t>(random_.uniform() * static_cast<double>(parents.size())));
    };
    const std::size_t one = place(), other = place();
    return parents[std::min(one, other)].constants;
  }

  std::vector<Found> members_;
  std::size_t kept_ = 0;
  VertexRandom& random_;
};

}  // namespace

Found search_constants(const VertexMotion& motion, double dt, const SpringFitSettings& settings, VertexRandom random,
                       const LogConstants* start) {
  const double strength = least_pull * motion.weight_of_wanted();
  const auto value = [&](const LogConstants& at) {
    const double loss = motion.loss(std::exp(at[0]), std::exp(at[1])) + strength * (at - usual()).squaredNorm();
    return std::isfinite(loss) ? loss : std::numeric_limits<double>::max();
  };
  const auto whole = [&](const LogConstants& at) {
    return with_pull(motion.loss_gradient(std::exp(at[0]), std::exp(at[1])), at, strength);
  };
  const auto one_frame = [&](const LogConstants& at) {
    return with_pull(motion.one_frame_loss_gradient(std::exp(at[0]), std::exp(at[1])), at, strength);
  };
  Population population(dt, settings.population, random);
  population.judge(value);
  if (start) {
    population.invite({*start, value(*start)});
  }
  // Weakly damped springs have a narrow valley around their frequency, which few members meet; the error of single frames has a
  // wide one there.
  const Found smooth = minimize(one_frame, population.best().constants, smooth_steps);
  population.invite({smooth.constants, value(smooth.constants)});
  double spread = 1.5;
  for (int generation = 1; generation < settings.generations; ++generation) {
    population.breed(spread);
    population.judge(value);
    spread *= 0.6;
  }
  // Springs that swing more than half a turn a frame have valleys at several frequencies: a few steps in each tell which is
  // deepest.
  std::vector<Found> starts = population.apart(most_starts);
  starts.push_back(minimize(one_frame, starts.front().constants, smooth_steps));
  for (Found& start_here : starts) {
    start_here = minimize(whole, start_here.constants, first_steps);
  }
  const auto deepest =
      std::min_element(starts.begin(), starts.end(), [](const Found& a, const Found& b) { return a.value < b.value; });
  return minimize(whole, deepest->constants, most_steps);
}

Found pulled_constants(const VertexMotion& motion, const Found& found, double pull) {
  const double strength = std::max(pull, least_pull) * motion.weight_of_wanted();
  const auto whole = [&](const LogConstants& at) {
    return with_pull(motion.loss_gradient(std::exp(at[0]), std::exp(at[1])), at, strength);
  };
  const Found near = minimize(whole, found.constants, most_steps), far = minimize(whole, usual(), most_steps);
  return far.value < near.value ? far : near;
}

}  // namespace followthrough

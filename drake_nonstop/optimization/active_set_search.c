/* The search of active_set_search.py, which explains it, in C: for a loop that is compiled.

   It follows the C of two functions of the data of an update: `search_problem`, which makes the
   numbers that are named below and then the polynomials (10, 3, p), and `speed_margins`, of [xi, A]
   and the data, which makes the margins of the p speeds and the least of all margins. Their sizes
   are defined before: DATA_SIZE, SPEEDS, and SEARCH_ARG, SEARCH_RES, SEARCH_IW and SEARCH_W, the
   largest work memory of the two. */

#include <math.h>

enum {
  REST_LENGTH,
  COMPLIANCE,
  FREQUENCY, /* before, as is the amplitude */
  AMPLITUDE,
  LOWER_FREQUENCY,
  LOWER_AMPLITUDE,
  UPPER_FREQUENCY,
  UPPER_AMPLITUDE,
  AMPLITUDE_WEIGHT,
  RATE_WEIGHT,
  ANCHOR_WEIGHT,
  NOMINAL_FREQUENCY,
  NOMINAL_AMPLITUDE,
  BOUND_SQUARED,
  MAX_SPEED_SQUARED,
  PHASE_JUMPS, /* other than 0: the phase depends on xi, and this search is none for it */
  POLYNOMIALS
};

#define AMPLITUDES_OVER_BOUNDS 32
#define MIN_AMPLITUDES 9
#define MORE_AMPLITUDES 24
#define AMPLITUDES_ABOUT_MINIMUM 5
#define MAX_RATIO 4.0
#define GOLDEN_STEPS 18
#define PREDICTION_TOLERANCE 3e-5
#define END_TOLERANCE 1e-9
#define MOST_COSTS 64    /* of one call of evaluate_evenly, which takes fewer than 40 */
#define MOST_UNCLEAR 256 /* minima; where there are more the search gives up */

typedef struct {
  double cost, low, high;
} minimum;

typedef struct {
  const double *given; /* what `search_problem` makes */
  int active[SPEEDS], actives;
  double best_cost, best_s, best_amplitude;
  minimum unclear[MOST_UNCLEAR];
  int unclears, is_wide, has_given_up;
} active_set;

static double square(double value) { return value * value; }
static double lesser(double a, double b) { return b < a ? b : a; }
static double greater(double a, double b) { return b > a ? b : a; }

static double change_cost(const double *given, double frequency, double amplitude, double s) {
  double cost = square(frequency - given[FREQUENCY]) +
                given[AMPLITUDE_WEIGHT] * square(amplitude - given[AMPLITUDE]) +
                given[RATE_WEIGHT] * square(s - given[FREQUENCY] * given[AMPLITUDE]);
  if (given[ANCHOR_WEIGHT] > 0)
    cost += given[ANCHOR_WEIGHT] * (square(frequency - given[NOMINAL_FREQUENCY]) +
                                    square(amplitude - given[NOMINAL_AMPLITUDE]));
  return cost;
}

static double cheapest_s(const double *given, double amplitude) {
  double wanted = (given[FREQUENCY] + given[ANCHOR_WEIGHT] * given[NOMINAL_FREQUENCY]) / amplitude +
                  given[RATE_WEIGHT] * (given[FREQUENCY] * given[AMPLITUDE]);
  return wanted / ((1 + given[ANCHOR_WEIGHT]) / (amplitude * amplitude) + given[RATE_WEIGHT]);
}

/* c, b and a of the squared speed c + 2 b s + a s^2 of an active speed, as `speed_squares`. */
static void speed_square(const active_set *search, int which, double amplitude, double *c,
                         double *b, double *a) {
  const double *given = search->given, *p = given + POLYNOMIALS + search->active[which];
  double values[10], g, h, g_squared, k, h_v, k_r;
  int j;
  for (j = 0; j < 10; j++, p += 3 * SPEEDS)
    values[j] = p[0] + amplitude * (p[SPEEDS] + amplitude * p[2 * SPEEDS]);
  g = given[REST_LENGTH] / sqrt(values[0]) + given[COMPLIANCE];
  h = (given[COMPLIANCE] - g) / values[0];
  g_squared = g * g;
  k = h * (given[COMPLIANCE] + g);
  h_v = h * values[4];
  k_r = k * values[5];
  *c = values[9] + g_squared * values[1] + 2 * (g * values[7] + h_v * values[5]) + k_r * values[5];
  *b = g * values[8] + g_squared * values[6] + (h_v + k_r) * values[3];
  *a = g_squared * values[2] + k * values[3] * values[3];
}

/* The least value from s on that is inside of none of the intervals [starts, ends]. */
static double next_allowed(double s, const double *starts, const double *ends, int count) {
  int moved = 1, j;
  while (moved) {
    moved = 0;
    for (j = 0; j < count; j++)
      if (starts[j] < s && s + END_TOLERANCE * fabs(s) < ends[j]) {
        s = ends[j];
        moved = 1;
      }
  }
  return s;
}

/* The cost of the best s at an amplitude, infinite if there is none; keeps the best. */
static double evaluate(active_set *search, double amplitude) {
  const double *given = search->given;
  double lowest = amplitude * given[LOWER_FREQUENCY], highest = amplitude * given[UPPER_FREQUENCY];
  double starts[SPEEDS], ends[SPEEDS], lower[SPEEDS], upper[SPEEDS]; /* the latter mirrored */
  double wanted, found[2], best = INFINITY;
  int count = 0, j;
  for (j = 0; j < search->actives; j++) {
    double c, b, a, root;
    speed_square(search, j, amplitude, &c, &b, &a);
    root = b * b - a * (c - given[BOUND_SQUARED]);
    if (root > 0) {
      root = sqrt(root);
      starts[count] = (-b - root) / a;
      ends[count] = (root - b) / a;
      upper[count] = -starts[count];
      lower[count] = -ends[count];
      count++;
    }
    if (given[MAX_SPEED_SQUARED] < INFINITY) {
      root = b * b - a * (c - given[MAX_SPEED_SQUARED]);
      if (root < 0) return INFINITY;
      root = sqrt(root);
      lowest = greater(lowest, (-b - root) / a);
      highest = lesser(highest, (root - b) / a);
    }
  }
  wanted = lesser(greater(cheapest_s(given, amplitude), lowest), highest);
  found[0] = found[1] = next_allowed(wanted, starts, ends, count);
  if (found[0] != wanted) found[1] = -next_allowed(-wanted, lower, upper, count);
  for (j = 0; j < 2; j++) {
    double cost, s = found[j];
    if (!(lowest <= s && s <= highest)) continue;
    cost = change_cost(given, s / amplitude, amplitude, s);
    if (cost < best) {
      best = cost;
      if (cost < search->best_cost) {
        search->best_cost = cost;
        search->best_s = s;
        search->best_amplitude = amplitude;
      }
    }
  }
  return best;
}

static void evaluate_evenly(active_set *search, double low, double step, int count) {
  double costs[MOST_COSTS + 2];
  int i, j;
  if (count < 1 || count > MOST_COSTS) {
    search->has_given_up = 1;
    return;
  }
  costs[0] = costs[count + 1] = INFINITY;
  for (i = 0; i < count; i++) costs[i + 1] = evaluate(search, low + i * step);
  for (i = 0; i < count; i++) {
    double before = costs[i], cost = costs[i + 1], after = costs[i + 2];
    double curvature = before - 2 * cost + after;
    int is_clear = 0;
    if (cost == INFINITY || cost > lesser(before, after)) continue;
    if (0 < curvature && curvature < INFINITY) {
      double shift = (before - after) / (2 * curvature);
      double vertex = cost - curvature * square(shift) / 2;
      double positions[2], predicted[2];
      positions[0] = shift;
      positions[1] = shift + copysign(0.5, -shift);
      predicted[0] = vertex;
      predicted[1] = vertex + curvature / 8;
      is_clear = 1;
      for (j = 0; j < 2 && is_clear; j++) {
        double own = evaluate(search, low + (i + positions[j]) * step);
        is_clear = fabs(own - predicted[j]) <= PREDICTION_TOLERANCE * cost;
      }
    }
    if (is_clear) continue;
    if (search->unclears == MOST_UNCLEAR) {
      search->has_given_up = 1;
      return;
    }
    search->unclear[search->unclears].cost = cost;
    search->unclear[search->unclears].low = low + (i > 0 ? i - 1 : 0) * step;
    search->unclear[search->unclears].high = low + (i < count - 1 ? i + 1 : count - 1) * step;
    search->unclears++;
  }
}

/* The part of the bounds of A that can hold something cheaper than the best so far; if any. */
static int within_reach(const active_set *search, double *low, double *high) {
  const double *given = search->given;
  double reach;
  if (search->best_cost == INFINITY) return 0;
  reach = sqrt(search->best_cost / given[AMPLITUDE_WEIGHT]);
  *low = greater(given[LOWER_AMPLITUDE], given[AMPLITUDE] - reach);
  *high = lesser(given[UPPER_AMPLITUDE], given[AMPLITUDE] + reach);
  return *low < *high;
}

static int amplitude_count(const double *given, double low, double high) {
  double share = (high - low) / (given[UPPER_AMPLITUDE] - given[LOWER_AMPLITUDE]);
  double octaves = log(high / low) / log(MAX_RATIO);
  return (int)ceil(MIN_AMPLITUDES * greater(1.0, octaves) + MORE_AMPLITUDES * share);
}

static int scan(active_set *search) {
  const double *given = search->given;
  double low = given[LOWER_AMPLITUDE], high = given[UPPER_AMPLITUDE];
  evaluate(search, lesser(greater(given[AMPLITUDE], low), high));
  if (search->best_cost == INFINITY) {
    double ratio = pow(high / low, 1.0 / (AMPLITUDES_OVER_BOUNDS - 1));
    int i;
    for (i = 0; i < AMPLITUDES_OVER_BOUNDS; i++)
      evaluate(search, lesser(low * pow(ratio, i), high));
  }
  if (within_reach(search, &low, &high)) {
    evaluate_evenly(search, low, (high - low) / (MIN_AMPLITUDES - 1), MIN_AMPLITUDES);
    search->is_wide = amplitude_count(given, low, high) > MIN_AMPLITUDES + 1;
  }
  return !(search->is_wide || search->unclears);
}

static void golden_section(active_set *search, double low, double high) {
  const double golden_ratio = (sqrt(5.0) - 1) / 2;
  double left = high - golden_ratio * (high - low), right = low + golden_ratio * (high - low);
  double left_cost = evaluate(search, left), right_cost = evaluate(search, right);
  int i;
  for (i = 0; i < GOLDEN_STEPS; i++) {
    if (left_cost < right_cost) {
      high = right;
      right = left;
      right_cost = left_cost;
      left = high - golden_ratio * (high - low);
      left_cost = evaluate(search, left);
    } else {
      low = left;
      left = right;
      left_cost = right_cost;
      right = low + golden_ratio * (high - low);
      right_cost = evaluate(search, right);
    }
  }
}

static int is_before(const minimum *a, const minimum *b) {
  if (a->cost != b->cost) return a->cost < b->cost;
  if (a->low != b->low) return a->low < b->low;
  return a->high < b->high;
}

/* Takes the least of the unclear minima out of them. */
static minimum taken(active_set *search) {
  int least = 0, j;
  minimum found;
  for (j = 1; j < search->unclears; j++)
    if (is_before(search->unclear + j, search->unclear + least)) least = j;
  found = search->unclear[least];
  search->unclear[least] = search->unclear[--search->unclears];
  return found;
}

static void refine(active_set *search) {
  minimum nearest[2];
  int count = 0, j;
  double low, high;
  if (search->is_wide) {
    search->unclears = 0;
    if (within_reach(search, &low, &high))
      while (low < high) {
        double end = lesser(high, MAX_RATIO * low);
        int amplitudes = amplitude_count(search->given, low, end);
        evaluate_evenly(search, low, (end - low) / (amplitudes - 1), amplitudes);
        low = end;
      }
  }
  while (count < 2 && search->unclears) nearest[count++] = taken(search);
  for (j = 0; j < count; j++) {
    double step = (nearest[j].high - nearest[j].low) / (AMPLITUDES_ABOUT_MINIMUM - 1);
    search->unclears = 0;
    evaluate_evenly(search, nearest[j].low, step, AMPLITUDES_ABOUT_MINIMUM);
    if (search->unclears) {
      minimum least = taken(search);
      golden_section(search, least.low, least.high);
    }
  }
}

/* The margins of the speeds at x = [xi, A], and the least of all margins, as it is returned. */
static double margins_at(const double *x, const double *data, double *margins) {
  const double *arg[SEARCH_ARG];
  double *res[SEARCH_RES], w[SEARCH_W], worst, given[2 + DATA_SIZE];
  casadi_int iw[SEARCH_IW];
  int j;
  for (j = 0; j < 2; j++) given[j] = x[j];
  for (j = 0; j < DATA_SIZE; j++) given[2 + j] = data[j];
  arg[0] = given;
  res[0] = margins;
  res[1] = &worst;
  speed_margins(arg, res, iw, w, 0);
  return worst;
}

static int least_of(const double *margins) {
  int least = 0, j;
  for (j = 1; j < SPEEDS; j++)
    if (margins[j] < margins[least]) least = j;
  return least;
}

/* Whether there is a feasible [xi, A] that is cheaper than what was before, which becomes `x`.

   Without one, or in doubt, others have to search. */
CASADI_SYMBOL_EXPORT int search(const double *data, double feasibility_tolerance, double *x) {
  const double *arg[SEARCH_ARG];
  double *res[SEARCH_RES], w[SEARCH_W], given[POLYNOMIALS + 30 * SPEEDS];
  double margins[SPEEDS], most = INFINITY;
  casadi_int iw[SEARCH_IW];
  active_set search;
  arg[0] = data;
  res[0] = given;
  search_problem(arg, res, iw, w, 0);
  if (given[PHASE_JUMPS] != 0) return 0;
  search.given = given;
  search.actives = 0;
  if (margins_at(given + FREQUENCY, data, margins) >= -feasibility_tolerance)
    most = change_cost(given, given[FREQUENCY], given[AMPLITUDE],
                       given[FREQUENCY] * given[AMPLITUDE]);
  while (search.actives < SPEEDS) {
    int worst = least_of(margins), j, is_enough;
    for (j = 0; j < search.actives; j++)
      if (search.active[j] == worst) return 0;
    search.active[search.actives++] = worst;
    search.best_cost = INFINITY;
    search.best_s = 0;
    search.best_amplitude = given[AMPLITUDE];
    search.unclears = search.is_wide = search.has_given_up = 0;
    is_enough = scan(&search);
    for (j = 0; j < 2; j++) {
      double frequency = search.best_s / search.best_amplitude;
      if (search.has_given_up || search.best_cost == INFINITY) return 0;
      x[0] = lesser(greater(frequency, given[LOWER_FREQUENCY]), given[UPPER_FREQUENCY]);
      x[1] = search.best_amplitude;
      margins_at(x, data, margins);
      if (margins[least_of(margins)] < -feasibility_tolerance) break; /* one is missing */
      if (j == 1 || is_enough) return search.best_cost < most;
      refine(&search);
    }
  }
  return 0;
}

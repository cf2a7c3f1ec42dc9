/* Follows the C of `side_by_side`, a loop's function of a whole sample for W flights at once, and
   evaluates it sample by sample, each flight in a lane of its own.

   In its `input` come the state, the parameters, the time, what blocks give that make updates
   themselves, and what stands outside; in its `results` the state after the sample, the signals,
   the signals of steps, what blocks read, whether what is made of their updates is right (1 or 0),
   and the sum of the squares of all but that. The sizes of all these are defined above. */

enum { TIME = STATE + PARAMETERS, OUT = TIME + 1 + ANSWERS, INPUTS = OUT + OUTSIDE };
enum { SIGNAL = STATE, STEP = SIGNAL + SIGNALS, VALID = STEP + STEPS + READ };
enum { SQUARES = VALID + IS_VALID, RESULTS = SQUARES + 1 };

typedef double quad __attribute__((vector_size(32), aligned(8), may_alias));
typedef long long order __attribute__((vector_size(32)));
#ifdef __clang__
#define MIXED(x, y, ...) __builtin_shufflevector(x, y, __VA_ARGS__)
#else
#define MIXED(x, y, ...) __builtin_shuffle(x, y, (order){__VA_ARGS__})
#endif

/* Four vectors get the first, the second ... value of each. */
#define TRANSPOSED(x0, x1, x2, x3, y0, y1, y2, y3)                        \
  {                                                                       \
    quad u = x0, v = x1, w = x2, z = x3;                                  \
    quad a = MIXED(u, v, 0, 4, 2, 6), b = MIXED(u, v, 1, 5, 3, 7);        \
    quad c = MIXED(w, z, 0, 4, 2, 6), d = MIXED(w, z, 1, 5, 3, 7);        \
    y0 = MIXED(a, c, 0, 1, 4, 5), y1 = MIXED(b, d, 0, 1, 4, 5);           \
    y2 = MIXED(a, c, 2, 3, 6, 7), y3 = MIXED(b, d, 2, 3, 6, 7);           \
  }
#define LANES(k) ((quad *)(values + j + k))[i / 4]
#define ROW(k) *(quad *)(rows[i + k] + j)

/* Writes the values of each lane to a row of its own. */
static void to_rows(lanes *values, double *const *rows, int size) {
  int i, j;
  for (i = 0; i < W; i += 4)
    for (j = 0; j + 4 <= size; j += 4)
      TRANSPOSED(LANES(0), LANES(1), LANES(2), LANES(3), ROW(0), ROW(1), ROW(2), ROW(3))
  for (j = size / 4 * 4; j < size; j++)
    for (i = 0; i < W; i++) rows[i][j] = values[j][i];
}

static void from_rows(lanes *values, const double *const *rows, int size) {
  int i, j;
  for (i = 0; i < W; i += 4)
    for (j = 0; j + 4 <= size; j += 4)
      TRANSPOSED(ROW(0), ROW(1), ROW(2), ROW(3), LANES(0), LANES(1), LANES(2), LANES(3))
  for (j = size / 4 * 4; j < size; j++)
    for (i = 0; i < W; i++) values[j][i] = rows[i][j];
}

/* Each flight goes on for its `samples` (1 or more), or fewer: it ends before a sample that a block
   has to make an update for, or at which the sum of squares is not below its limit. The next flight
   then takes its lane. `flown` gets how many samples each has flown.

   samples, limits, states, parameters: a row for each flight; `states` get those after the last
     sample
   times, outside, signals, steps: a row for each sample of the first flight, then of the second ...
*/
void fly_lanes(long long flights, const long long *samples, const double *limits, double *states,
               const double *parameters, const double *times, const double *outside,
               double *signals, double *steps, long long *flown) {
  lanes input[INPUTS + 1] = {0}, results[RESULTS];
  double nowhere[SIGNALS + STEPS + 1], *signal_rows[W], *step_rows[W]; /* of lanes that go on */
  const double *outside_rows[W];
  masks goes_on;
  long long flight[W], row[W], end[W], next = 0, first = 0, active = 0;
  int i, j, is_right;
  for (i = 0; i < W; i++) flight[i] = -1, outside_rows[i] = outside;
  while (next < flights || active > 0) {
    for (i = 0; i < W; i++) {
      if (flight[i] < 0 && next < flights) {
        for (j = 0; j < STATE; j++) input[j][i] = states[next * STATE + j];
        for (j = 0; j < PARAMETERS; j++) input[STATE + j][i] = parameters[next * PARAMETERS + j];
        row[i] = first;
        first = end[i] = first + samples[next];
        flown[next] = 0;
        flight[i] = next++;
        active++;
      }
      if (flight[i] < 0) continue;
      input[TIME][i] = times[row[i]];
      outside_rows[i] = outside + row[i] * OUTSIDE;
    }
    from_rows(input + OUT, outside_rows, OUTSIDE);
    side_by_side(input, results);
    for (i = 0; i < W; i++) {
      signal_rows[i] = step_rows[i] = nowhere;
      is_right = flight[i] >= 0 && results[SQUARES][i] < limits[flight[i]]; /* or no number */
      for (j = 0; j < IS_VALID; j++) is_right &= results[VALID + j][i] == 1;
      goes_on[i] = -is_right;
      if (!is_right) continue;
      signal_rows[i] = signals + row[i] * SIGNALS;
      step_rows[i] = steps + row[i] * STEPS;
      flown[flight[i]]++;
      row[i]++;
    }
    for (j = 0; j < STATE; j++)
      input[j] = (lanes)((goes_on & (masks)results[j]) | (~goes_on & (masks)input[j]));
    to_rows(results + SIGNAL, signal_rows, SIGNALS);
    to_rows(results + STEP, step_rows, STEPS);
    for (i = 0; i < W; i++) {
      if (flight[i] < 0 || (goes_on[i] && row[i] < end[i])) continue;
      for (j = 0; j < STATE; j++) states[flight[i] * STATE + j] = input[j][i];
      flight[i] = -1;
      active--;
    }
  }
}

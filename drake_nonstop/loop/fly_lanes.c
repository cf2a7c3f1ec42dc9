/* Follows the C of `side_by_side`, a loop's function of a whole sample for W flights at once, and
   evaluates it sample by sample, each flight in a lane of its own.

   In its `input` come the state, the parameters, the time, what blocks give that make updates
   themselves, and what stands outside; in its `results` the state after the sample, the signals,
   the signals of steps, what blocks read, whether what is made of their updates is right (1 or 0),
   and the sum of the squares of all but that. The sizes of all these are defined above. */

enum { TIME = STATE + PARAMETERS, OUT = TIME + 1 + ANSWERS, INPUTS = OUT + OUTSIDE };
enum { SIGNAL = STATE, STEP = SIGNAL + SIGNALS, VALID = STEP + STEPS + READ };
enum { SQUARES = VALID + IS_VALID, RESULTS = SQUARES + 1 };

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
  long long flight[W], row[W], end[W], next = 0, first = 0, active = 0;
  int i, j, is_right;
  for (i = 0; i < W; i++) flight[i] = -1;
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
      for (j = 0; j < OUTSIDE; j++) input[OUT + j][i] = outside[row[i] * OUTSIDE + j];
    }
    side_by_side(input, results);
    for (i = 0; i < W; i++) {
      if (flight[i] < 0) continue;
      is_right = results[SQUARES][i] < limits[flight[i]]; /* it may be no number */
      for (j = 0; j < IS_VALID; j++) is_right &= results[VALID + j][i] == 1;
      if (is_right) {
        for (j = 0; j < STATE; j++) input[j][i] = results[j][i];
        for (j = 0; j < SIGNALS; j++) signals[row[i] * SIGNALS + j] = results[SIGNAL + j][i];
        for (j = 0; j < STEPS; j++) steps[row[i] * STEPS + j] = results[STEP + j][i];
        flown[flight[i]]++;
        row[i]++;
      }
      if (is_right && row[i] < end[i]) continue;
      for (j = 0; j < STATE; j++) states[flight[i] * STATE + j] = input[j][i];
      flight[i] = -1;
      active--;
    }
  }
}

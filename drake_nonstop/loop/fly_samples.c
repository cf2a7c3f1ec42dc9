/* Follows the C of a loop's function of a whole sample, `loop`, and evaluates it sample by sample.

   `loop` has one argument: its state comes first, and the results are, in this order, the state
   after the sample, the signals, the signals of steps, what blocks read, whether what is made of
   their updates is right (1 or 0), and the sum of the squares of all but that. */

#include <string.h>

enum { STATE, SIGNALS, STEPS, READ, IS_VALID, SQUARES, RESULTS };

/* Returns how many samples were flown: fewer than `samples` where a block has to make its update,
   or the sum of squares is not below `limit`. `input` has the state after the last one of them.

   places: of the time in `input`, and of what stands outside
   sizes: of the state, of both rows of signals, of whether updates are right, and of what stands
          outside
   times, outside: a row for each sample
   results: room for one of each kind; signals and steps: rows for all samples
   arg, res, iw, w: the work memory of `loop` */
CASADI_SYMBOL_EXPORT casadi_int fly_samples(casadi_int samples, casadi_real limit,
                                            const casadi_int *places, const casadi_int *sizes,
                                            const casadi_real *times, const casadi_real *outside,
                                            casadi_real *input, casadi_real *const *results,
                                            casadi_real *signals, casadi_real *steps,
                                            const casadi_real **arg, casadi_real **res,
                                            casadi_int *iw, casadi_real *w) {
  casadi_int k, j;
  for (k = 0; k < samples; k++) {
    input[places[0]] = times[k];
    memcpy(input + places[1], outside + k * sizes[4], sizes[4] * sizeof *input);
    arg[0] = input;
    for (j = 0; j < RESULTS; j++) res[j] = results[j];
    res[SIGNALS] = signals + k * sizes[1];
    res[STEPS] = steps + k * sizes[2];
    loop(arg, res, iw, w, 0);
    for (j = 0; j < sizes[3]; j++)
      if (results[IS_VALID][j] != 1) return k;
    if (!(results[SQUARES][0] < limit)) return k; /* which may be no number */
    memcpy(input, results[STATE], sizes[0] * sizeof *input);
  }
  return k;
}

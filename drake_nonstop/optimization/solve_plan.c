/* Successive quadratic programs for a plan: `HorizonSolver._solve` in horizon_solver.py, as C.

   Each part has the name that it has there, in horizon_problem.py or in linearization.py, and does
   the same. Constraints are numbered as in `ConstraintLayout`; arrays are stored row by row. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define ENTRIES 6 /* of a `PlannedOrbit`: angle, xi, its rate, A, its rate, its second rate */
#define NEIGHBOURS 3
enum { ANGLE, FREQUENCY, FREQUENCY_RATE, AMPLITUDE };

static const int64_t shifts[NEIGHBOURS] = {-1, 1, 2};

/* DAQP 0.11: its problem, and its result. */
typedef struct {
  int n, m, ms;
  double *H, *f, *A, *bupper, *blower;
  int *sense, *break_points;
  int nh, problem_type;
} Program;

typedef struct {
  double *x, *lam;
  double fval, soft_slack;
  int exitflag, iter, nodes;
  double solve_time, setup_time;
} Result;

/* A traced function of entries (rows, columns), in memory that it is bound to. */
typedef struct {
  void (*evaluate)(void *);
  void *buffer;
  double *inputs;        /* the first six: the orbit */
  const double *results; /* (values, 1 + 6, entries) */
  int64_t values, rows, columns;
  const int64_t *instants; /* (rows), of the plan */
  const int64_t *places;   /* (values, entries): the numbers of the constraints */
  int64_t along;           /* so many rows are of the plan, the others of constant xi and A */
  const double *angles;    /* (rows), of the latter */
  const int64_t *term_rows, *term_columns; /* (rows); (terms, columns): in the flat terms */
  int64_t terms, constants, of_flight;     /* their numbers, and whether they are those of flight */
} Margins;

/* The limits of carriers at the phases of an orbit, at an instant and an A. */
typedef struct {
  void (*evaluate)(void *);
  void *buffer;
  double *inputs;        /* (12 terms, u and u', A, the bound; phases, carriers) */
  const double *results; /* (least s, most s, margins; phases, carriers) */
  int64_t values, phases, carriers;
} Limits;

/* Constraints of neighbouring instants, between which margins dip. */
typedef struct {
  int64_t first, rows, columns;
} Neighbours;

typedef struct {
  void (*daqp)(Result *, Program *, void *);
  int64_t instants, count, fixed, constraints, slacks, angles, differences, carriers;
  const double *rows;         /* (6, instants, count) */
  const int64_t *ends;        /* (6, instants, 2): where a row begins and ends to be other than 0 */
  const double *hessian; /* (2 count, 2 count) */
  /* Of a step's program. Its variables are the slacks, and behind them z: the free coefficients
     change by T z, the cost by z'z/2 and a linear part, which saves DAQP most of its preparation. */
  const double *step_hessian; /* (variables, variables) */
  const double *step_rows;    /* (6, instants, free): as `rows`, by z */
  const double *fixed_rows;   /* (2 free + angles + differences, variables): T, and others */
  const double *weights;      /* (slacks) */
  const double *bounds;       /* (4): of xi and A, the least ones and the largest ones */
  const double *difference_rows; /* (differences, 2 count) */
  const double *largest;         /* (differences) */
  const int64_t *instant_of, *slack_of, *before, *after, *widths; /* (constraints) */
  int64_t function_count, neighbour_count;
  const Margins *functions;
  const Neighbours *neighbours;
  int64_t terminal, terminal_count, amplitude_count; /* the first constraint, and the sizes */
  const int64_t *terminal_at;                        /* (terminal_count) */
  int64_t has[3]; /* of the limits of the terminal set: those that there are */
  double terminal_unit, least_amplitude, amplitude_spacing;
  const Limits *limits;
  const double *settings;
} Horizon;

/* As of `HorizonData`. */
typedef struct {
  double bound, unit;
  const double *excess; /* (instants, carriers): what the targets are above the bound, as margins */
  /* As of `BowLosses`; NULL: cables are straight. */
  const double *losses, *loss_slopes, *lossy_plan;
  double *tables;     /* (3, terminal_count, amplitude_count); NaN: not found */
  int64_t table_size; /* from one limit to the next */
  const double *apart, *terminal_terms, *bounds; /* as of `TerminalTables` */
  struct {
    const double *values;
    int64_t size;
  } terms[2]; /* flat, of orbits and of flight */
} Data;

enum {
  ANGLE_RADIUS,
  COEFFICIENT_RADIUS,
  LARGEST_MARGIN,
  NEAR_MARGIN,
  LEAST_RATIO,
  FAIR_RATIO,
  GOOD_RATIO,
  LEAST_SCALE,
  LARGEST_SCALE,
  ROW_TOLERANCE,
  ACTIVE_MARGIN,
  PLAN_TOLERANCE,
  LITTLE_SLACK,
  MOST_ROUNDS
};

typedef struct {
  double *margins, *gradients, *dips; /* (constraints), times six, times three */
  double slowest;                     /* of the margins of speeds, without dips */
} Linearization;

typedef struct {
  const Horizon *h;
  const Data *data;
  double *memory;
  double *orbit, *step_orbit; /* (6, instants) */
  double *raw, *changed, *excess, *flat_step, *corrected;
  double *program_rows, *lower, *upper, *gradient, *solution, *multipliers;
  int64_t room, *chosen, chosen_count;
  int *sense;
  char *is_chosen, *is_active;
} Work;

static double largest(double a, double b) { return a > b ? a : b; }
static double least(double a, double b) { return a < b ? a : b; }
static double clip(double x, double low, double high) { return least(largest(x, low), high); }

/* The entries of the orbit (6, instants), of coefficients or of a step of them (2, count). */
static void orbit_of(const Horizon *h, const double *coefficients, double *orbit) {
  int64_t i, k, j;
  for (i = 0; i < ENTRIES; i++)
    for (k = 0; k < h->instants; k++) {
      const int64_t place = i * h->instants + k;
      const double *row = h->rows + place * h->count, *own = coefficients + (i / 3) * h->count;
      double sum = 0;
      for (j = h->ends[2 * place]; j < h->ends[2 * place + 1]; j++) sum += row[j] * own[j];
      orbit[place] = sum;
    }
}

/* Gives a function the terms, the bound and its unit. */
static void give_terms(const Margins *f, const Data *data) {
  const int64_t entries = f->rows * f->columns;
  double *next = f->inputs + ENTRIES * entries;
  int64_t i, k, j;
  for (i = 0; i < f->terms; i++)
    for (k = 0; k < f->rows; k++) {
      const double *row = data->terms[f->of_flight].values;
      row += f->term_rows[k] * data->terms[f->of_flight].size;
      for (j = 0; j < f->columns; j++) *next++ = row[f->term_columns[i * f->columns + j]];
    }
  next += f->constants * entries;
  for (k = 0; k < entries; k++) next[k] = data->bound, next[entries + k] = data->unit;
}

static void margins_of(const Work *w, const Margins *f, const Linearization *lin, double start) {
  const Horizon *h = w->h;
  const int64_t entries = f->rows * f->columns;
  int64_t i, k, j, e;
  for (k = 0; k < f->rows; k++) {
    const int64_t at = f->instants[k];
    for (i = 0; i < ENTRIES; i++) {
      double value = w->orbit[i * h->instants + at];
      if (i == ANGLE) value = k < f->along ? start + value : f->angles[k];
      else if (k >= f->along && i != FREQUENCY && i != AMPLITUDE) value = 0;
      for (j = 0; j < f->columns; j++) f->inputs[i * entries + k * f->columns + j] = value;
    }
  }
  f->evaluate(f->buffer);
  for (i = 0; i < f->values; i++) {
    const double *results = f->results + i * (1 + ENTRIES) * entries;
    const int64_t *places = f->places + i * entries;
    for (e = 0; e < entries; e++) lin->margins[places[e]] = results[e];
    for (j = 0; j < ENTRIES; j++) {
      const double *slopes = results + (1 + j) * entries;
      double *gradients = lin->gradients + j * h->constraints;
      for (e = 0; e < f->along * f->columns; e++) gradients[places[e]] = slopes[e];
      for (; e < entries; e++)
        gradients[places[e]] = j == FREQUENCY || j == AMPLITUDE ? slopes[e] : 0;
    }
  }
}

static void with_dips(const Work *w, const Neighbours *b, const Linearization *lin) {
  const int64_t width = b->columns, count = w->h->constraints;
  int64_t k, j, e;
  memcpy(w->raw, lin->margins + b->first, b->rows * width * sizeof(double));
  for (k = 1; k + 2 < b->rows; k++)
    for (j = 0; j < width; j++) {
      const double *at = w->raw + k * width + j;
      const double begin = (at[width] - at[-width]) / 2, end = (at[2 * width] - at[0]) / 2;
      if (!(begin < 0 && end > 0)) continue;
      const double rise = at[width] - at[0];
      const double a = 3 * (begin + end - 2 * rise), s = 2 * (3 * rise - 2 * begin - end);
      const double x = -2 * begin / (s + sqrt(s * s - 4 * a * begin));
      const double of_end = x * x * (3 - 2 * x), rest = 1 - x;
      const double of_begin_slope = x * (rest * rest), of_end_slope = -x * x * rest;
      const double weights[NEIGHBOURS] = {-of_begin_slope / 2, of_end + of_begin_slope / 2,
                                          of_end_slope / 2};
      const int64_t number = b->first + k * width + j;
      for (e = 0; e < NEIGHBOURS; e++) {
        lin->dips[e * count + number] = weights[e];
        lin->margins[number] += weights[e] * (at[shifts[e] * width] - at[0]);
      }
    }
}

/* Finds an entry of the tables, as `TerminalTables` does. */
static void find_entry(const Work *w, int64_t k, int64_t entry) {
  enum { TERMS = 12, DIRECTIONS = 6 };
  const Horizon *h = w->h;
  const Data *data = w->data;
  const Limits *f = h->limits;
  const int64_t n = f->carriers, entries = f->phases * n;
  const int64_t place = k * h->amplitude_count + entry;
  const double *terms = data->terminal_terms + k * (9 * n + 3);
  double found[3] = {0, INFINITY, data->apart[place]};
  int64_t i, p, j;
  for (i = 0; i < TERMS; i++)
    for (p = 0; p < f->phases; p++)
      for (j = 0; j < n; j++)
        f->inputs[i * entries + p * n + j] =
            i < 9 ? terms[(i / 3 * n + j) * 3 + i % 3] : terms[9 * n + i % 3];
  for (i = 0; i < entries; i++) {
    f->inputs[(TERMS + DIRECTIONS) * entries + i] = h->least_amplitude + entry * h->amplitude_spacing;
    f->inputs[(TERMS + DIRECTIONS + 1) * entries + i] = data->bounds[k * n + i % n];
  }
  f->evaluate(f->buffer);
  for (i = 0; i < entries; i++) found[0] = largest(found[0], f->results[i]);
  for (i = entries; i < 2 * entries; i++) found[1] = least(found[1], f->results[i]);
  for (i = 2 * entries; i < f->values * entries; i++) found[2] = least(found[2], f->results[i]);
  for (i = 0; i < 3; i++) data->tables[i * data->table_size + place] = found[i];
}

static void terminal_margins(const Work *w, const Linearization *lin) {
  const Horizon *h = w->h;
  const Data *data = w->data;
  const double unit = h->terminal_unit;
  int64_t k, t, kind;
  for (k = 0; k < h->terminal_count; k++) {
    const int64_t at = h->terminal_at[k];
    const double xi = w->orbit[FREQUENCY * h->instants + at];
    const double A = w->orbit[AMPLITUDE * h->instants + at];
    const double last = h->amplitude_count - 1.000001;
    const double table_place = (A - h->least_amplitude) / h->amplitude_spacing;
    const double place = isnan(A) ? 0 : clip(table_place, 0, last);
    const int64_t left = (int64_t)place;
    const double *table = data->tables + k * h->amplitude_count + left;
    double value[3], slope[3], margins[3], by_xi[3], by_A[3];
    for (t = 0; t < 2; t++)
      if (isnan(table[t])) find_entry(w, k, left + t);
    for (t = 0; t < 3; t++, table += data->table_size) {
      value[t] = table[0] + (place - left) * (table[1] - table[0]);
      slope[t] = (table[1] - table[0]) / h->amplitude_spacing;
    }
    margins[0] = (A * xi - value[0]) / unit, by_xi[0] = A / unit, by_A[0] = (xi - slope[0]) / unit;
    margins[1] = (value[1] - A * xi) / unit, by_xi[1] = -A / unit, by_A[1] = (slope[1] - xi) / unit;
    margins[2] = value[2], by_xi[2] = 0, by_A[2] = slope[2];
    for (t = 0, kind = 0; t < 3; t++) {
      const int64_t number = h->terminal + kind * h->terminal_count + k;
      if (!h->has[t]) continue;
      lin->margins[number] = margins[t];
      lin->gradients[FREQUENCY * h->constraints + number] = by_xi[t];
      lin->gradients[AMPLITUDE * h->constraints + number] = by_A[t];
      kind++;
    }
  }
}

static void lose(const Work *w, const Linearization *lin, double start) {
  const Horizon *h = w->h;
  const Data *data = w->data;
  int64_t i, e;
  for (i = 0; i < h->constraints; i++) {
    const int64_t at = h->instant_of[i];
    double loss = data->losses[i];
    for (e = 0; e < ENTRIES; e++) {
      const double slope = data->loss_slopes[e * h->constraints + i];
      const double now = w->orbit[e * h->instants + at] + (e == ANGLE ? start : 0);
      loss += slope * (now - data->lossy_plan[e * h->instants + at]);
      lin->gradients[e * h->constraints + i] -= slope;
    }
    lin->margins[i] -= loss;
  }
}

static void linearize(const Work *w, const double *x, double start, Linearization *lin) {
  const Horizon *h = w->h;
  const int64_t columns = h->neighbours[0].columns;
  int64_t i, k, j;
  orbit_of(h, x, w->orbit);
  memset(lin->dips, 0, NEIGHBOURS * h->constraints * sizeof(double));
  for (i = 0; i < h->function_count; i++) margins_of(w, h->functions + i, lin, start);
  terminal_margins(w, lin);
  if (w->data->losses) lose(w, lin, start);
  lin->slowest = INFINITY;
  for (k = 0; k < h->instants; k++)
    for (j = 0; j < h->carriers; j++)
      lin->slowest = least(lin->slowest, lin->margins[k * columns + j]);
  for (i = 0; i < h->neighbour_count; i++) with_dips(w, h->neighbours + i, lin);
  for (k = 0; k < h->instants; k++)
    for (j = 0; j < h->carriers; j++)
      lin->margins[k * columns + j] -= w->data->excess[k * h->carriers + j];
}

static void swap(Linearization *a, Linearization *b) {
  const Linearization other = *a;
  *a = *b, *b = other;
}

static double cost(const Horizon *h, const double *x) {
  const int64_t size = 2 * h->count;
  double sum = 0;
  int64_t i, j;
  for (i = 0; i < size; i++) {
    double row = 0;
    for (j = 0; j < size; j++) row += h->hessian[i * size + j] * (x[j] - 1);
    sum += (x[i] - 1) * row;
  }
  return sum / 2;
}

/* The penalty of the least slacks that margins need; `most` is the largest of these. */
static double penalty(const Horizon *h, const double *margins, double *slacks, double *most) {
  double sum = 0;
  int64_t i;
  memset(slacks, 0, h->slacks * sizeof(double));
  for (i = 0; i < h->constraints; i++) {
    double *slack = slacks + h->slack_of[i];
    *slack = largest(*slack, -margins[i]);
    if (isnan(margins[i])) sum = NAN;
  }
  *most = 0;
  for (i = 0; i < h->slacks; i++) {
    sum += h->weights[i] * slacks[i];
    *most = largest(*most, slacks[i]);
  }
  return sum;
}

/* Change of the margins by a step (2, count), to first order. */
static void changes(const Work *w, const Linearization *lin, const double *step, double *found) {
  const Horizon *h = w->h;
  const int64_t count = h->constraints;
  double *own = w->excess; /* the room of it */
  int64_t i, e;
  orbit_of(h, step, w->step_orbit);
  for (i = 0; i < count; i++) {
    const double *orbit = w->step_orbit + h->instant_of[i], *gradient = lin->gradients + i;
    double sum = 0;
    for (e = 0; e < ENTRIES; e++) sum += gradient[e * count] * orbit[e * h->instants];
    own[i] = found[i] = sum;
  }
  for (i = 0; i < count; i++)
    for (e = 0; e < NEIGHBOURS && h->widths[i]; e++) {
      const double weight = lin->dips[e * count + i];
      if (weight != 0) found[i] += weight * (own[i + shifts[e] * h->widths[i]] - own[i]);
    }
}

/* A row of the margins' Jacobian by z, times a weight, added to `row`. */
static void add_row(const Horizon *h, const Linearization *lin, int64_t number, double weight,
                    double *row) {
  const int64_t free_count = h->count - h->fixed;
  int64_t i, j;
  for (i = 0; i < ENTRIES; i++) {
    const double slope = weight * lin->gradients[i * h->constraints + number];
    const double *rows = h->step_rows + (i * h->instants + h->instant_of[number]) * free_count;
    double *own = row + (i / 3) * free_count;
    if (slope == 0) continue;
    for (j = 0; j < free_count; j++) own[j] += slope * rows[j];
  }
}

static void jacobian_row(const Horizon *h, const Linearization *lin, int64_t number, double *row) {
  double own = 1;
  int64_t e;
  for (e = 0; e < NEIGHBOURS; e++) {
    const double weight = lin->dips[e * h->constraints + number];
    if (weight == 0) continue;
    add_row(h, lin, number + shifts[e] * h->widths[number], weight, row);
    own -= weight;
  }
  add_row(h, lin, number, own, row);
}

static int is_dip(const Horizon *h, const double *margins, int64_t i, double most) {
  if (h->before[i] >= 0 && !(margins[i] <= margins[h->before[i]])) return 0;
  if (h->after[i] >= 0 && !(margins[i] < margins[h->after[i]])) return 0;
  return margins[i] <= most;
}

/* Chooses a constraint, and those next to it whose margins are at most `most`. */
static void choose(const Work *w, const double *margins, int64_t i, double most) {
  const Horizon *h = w->h;
  const int64_t next[2] = {h->before[i], h->after[i]};
  int k;
  if (!w->is_chosen[i]) w->is_chosen[i] = 1;
  for (k = 0; k < 2 && h->widths[i]; k++)
    if (next[k] >= 0 && margins[next[k]] <= most && !w->is_chosen[next[k]])
      w->is_chosen[next[k]] = 1;
}

static int make_room(Work *w, int64_t rows, int64_t variables) {
  const int64_t all = rows + variables;
  if (rows <= w->room) return 1;
  w->room = 2 * rows;
  free(w->program_rows), free(w->lower), free(w->upper), free(w->multipliers), free(w->sense);
  w->program_rows = malloc(w->room * variables * sizeof(double));
  w->lower = malloc((w->room + all) * sizeof(double));
  w->upper = malloc((w->room + all) * sizeof(double));
  w->multipliers = malloc((w->room + all) * sizeof(double));
  w->sense = malloc((w->room + all) * sizeof(int));
  return w->program_rows && w->lower && w->upper && w->multipliers && w->sense;
}

/* Solves the program of a step under the chosen constraints: 1, or 0 where there is no solution. */
static int solved(Work *w, const Linearization *lin, const double *margins, const double *x,
                  double scale) {
  const Horizon *h = w->h;
  const double *settings = h->settings;
  const int64_t free_count = h->count - h->fixed, variables = 2 * free_count + h->slacks;
  const int64_t fixed_rows = 2 * free_count + h->angles + h->differences;
  const double radius = scale * settings[COEFFICIENT_RADIUS];
  int64_t i, j, rows = fixed_rows;
  for (i = 0, w->chosen_count = 0; i < h->constraints; i++)
    if (w->is_chosen[i]) w->chosen[w->chosen_count++] = i;
  rows += w->chosen_count;
  if (!make_room(w, rows, variables)) return -1;
  double *lower = w->lower + h->slacks, *upper = w->upper + h->slacks;
  for (i = 0; i < h->slacks; i++) w->lower[i] = 0, w->upper[i] = 1e30;
  for (i = 0; i < 2 * free_count; i++) {
    const int64_t spline = i / free_count;
    const double own = x[spline * h->count + h->fixed + i % free_count];
    *lower++ = clip(h->bounds[spline] - own, -radius, 0); /* no change is always allowed */
    *upper++ = clip(h->bounds[2 + spline] - own, 0, radius);
  }
  for (i = 0; i < h->angles; i++)
    upper[i] = scale * settings[ANGLE_RADIUS], lower[i] = -upper[i];
  for (i = 0; i < h->differences; i++) {
    double difference = 0;
    for (j = 0; j < 2 * h->count; j++) difference += h->difference_rows[i * 2 * h->count + j] * x[j];
    lower[h->angles + i] = least(-h->largest[i] - difference, 0);
    upper[h->angles + i] = largest(h->largest[i] - difference, 0);
  }
  lower += h->angles + h->differences, upper += h->angles + h->differences;
  memcpy(w->program_rows, h->fixed_rows, fixed_rows * variables * sizeof(double));
  for (i = 0; i < w->chosen_count; i++) {
    double *row = w->program_rows + (fixed_rows + i) * variables;
    memset(row, 0, variables * sizeof(double));
    jacobian_row(h, lin, w->chosen[i], row + h->slacks);
    row[h->slack_of[w->chosen[i]]] = 1;
    lower[i] = -margins[w->chosen[i]], upper[i] = 1e30;
  }
  memset(w->sense, 0, (h->slacks + rows) * sizeof(int));
  memset(w->solution, 0, variables * sizeof(double));
  Program program = {.n = variables, .m = h->slacks + rows, .ms = h->slacks,
                     .H = (double *)h->step_hessian, .f = w->gradient, .A = w->program_rows,
                     .bupper = w->upper, .blower = w->lower, .sense = w->sense};
  Result result = {.x = w->solution, .lam = w->multipliers};
  h->daqp(&result, &program, NULL);
  return result.exitflag == 1;
}

/* Takes a step from `x` to `found`, of margins that may differ from those of the linearization;
   1, or 0 where there is none. `predicted` is the merit that it should have. */
static int step(Work *w, const Linearization *lin, const double *margins, const double *x,
                double scale, double *found, double *slacks, double *predicted) {
  const Horizon *h = w->h;
  const double *settings = h->settings;
  const int64_t free_count = h->count - h->fixed, count = h->constraints;
  const int64_t variables = 2 * free_count + h->slacks;
  int64_t i, j, round;
  double most;
  memset(w->gradient, 0, variables * sizeof(double));
  memcpy(w->gradient, h->weights, h->slacks * sizeof(double));
  for (i = 0; i < 2 * free_count; i++) {
    const int64_t row = (i / free_count) * h->count + h->fixed + i % free_count;
    double slope = 0;
    for (j = 0; j < 2 * h->count; j++) slope += h->hessian[row * 2 * h->count + j] * (x[j] - 1);
    for (j = h->slacks; j < variables; j++)
      w->gradient[j] += slope * h->fixed_rows[i * variables + j];
  }
  memcpy(w->is_chosen, w->is_active, count);
  for (i = 0; i < count; i++)
    if (is_dip(h, margins, i, settings[LARGEST_MARGIN]))
      choose(w, margins, i, settings[NEAR_MARGIN]);
  for (round = 0; round < (int64_t)settings[MOST_ROUNDS]; round++) {
    const int is_solved = solved(w, lin, margins, x, scale);
    int is_new = 0;
    if (is_solved != 1) return is_solved;
    memset(w->flat_step, 0, 2 * h->count * sizeof(double));
    for (i = 0; i < 2 * free_count; i++) {
      double *change = w->flat_step + (i / free_count) * h->count + h->fixed + i % free_count;
      for (j = h->slacks; j < variables; j++)
        *change += h->fixed_rows[i * variables + j] * w->solution[j];
    }
    changes(w, lin, w->flat_step, w->changed);
    memset(w->is_active, 0, count);
    for (i = 0; i < count; i++) {
      w->changed[i] += margins[i];
      w->excess[i] = w->changed[i] + w->solution[h->slack_of[i]];
      if (w->is_chosen[i]) w->is_active[i] = w->excess[i] < settings[ACTIVE_MARGIN];
    }
    memcpy(w->raw, w->excess, count * sizeof(double)); /* is_dip of it, while choosing */
    for (i = 0; i < w->chosen_count; i++) w->is_chosen[w->chosen[i]] = 2; /* those of before */
    for (i = 0; i < count; i++)
      if (w->is_chosen[i] != 2 && is_dip(h, w->raw, i, -settings[ROW_TOLERANCE])) {
        choose(w, w->raw, i, settings[ACTIVE_MARGIN]);
        is_new = 1;
      }
    if (!is_new) break;
  }
  for (i = 0; i < 2 * h->count; i++) found[i] = x[i] + w->flat_step[i];
  *predicted = cost(h, found) + penalty(h, w->changed, slacks, &most);
  return 1;
}

static void release(Work *w) {
  free(w->memory), free(w->chosen), free(w->is_chosen), free(w->program_rows);
  free(w->lower), free(w->upper), free(w->multipliers), free(w->sense);
}

static int reserve(Work *w, Linearization *now, Linearization *there, double **slacks, double **xs) {
  const Horizon *h = w->h;
  const int64_t c = h->constraints, x = 2 * h->count, o = ENTRIES * h->instants;
  const int64_t one = (1 + ENTRIES + NEIGHBOURS) * c;
  const int64_t variables = x - 2 * h->fixed + h->slacks;
  double *next = calloc(2 * one + 2 * o + 4 * c + 4 * x + 2 * variables + h->slacks, sizeof(double));
  w->memory = next;
  w->chosen = malloc(c * sizeof(int64_t));
  w->is_chosen = calloc(2 * c, 1), w->is_active = w->is_chosen + c;
  if (!next || !w->chosen || !w->is_chosen) return 0;
  now->margins = next, now->gradients = next + c, now->dips = next + (1 + ENTRIES) * c, next += one;
  there->margins = next, there->gradients = next + c, there->dips = next + (1 + ENTRIES) * c;
  next += one;
  w->orbit = next, w->step_orbit = next + o, next += 2 * o;
  w->raw = next, w->changed = next + c, w->excess = next + 2 * c, w->corrected = next + 3 * c;
  next += 4 * c;
  w->flat_step = next, next += x;
  *xs = next, next += 3 * x;
  w->gradient = next, w->solution = next + variables, next += 2 * variables;
  *slacks = next;
  return 1;
}

/* Solves for the coefficients `x` (2, count), within their limits at the start, and at the end the
   best that was found. `numbers` are given the phase at the start, the tolerance, the scale of the
   trust region and whether to end with the first plan without slack, and made the cost, the slack,
   the scale, the margin of the slowest speed, and whether it has converged; `margins` are
   those at the end. Returns the number of programs; -1: a value is not finite; -2: no memory. */
__attribute__((visibility("default")))
int64_t solve_plan(const Horizon *h, const Data *data, int64_t max_iterations, double *x,
                   double *numbers, double *margins) {
  const double *settings = h->settings;
  const double start = numbers[0], tolerance = numbers[1];
  const int until_feasible = numbers[3] != 0;
  const size_t size = 2 * h->count * sizeof(double);
  Work work = {.h = h, .data = data}, *w = &work;
  Linearization now, there;
  double *slacks, *xs, slack, merit, scale = numbers[2];
  int64_t i, iterations = 0;
  int is_found, converged = 0;
  if (!reserve(w, &now, &there, &slacks, &xs)) return release(w), -2;
  double *candidate = xs, *again = xs + 2 * h->count, *difference = xs + 4 * h->count;
  for (i = 0; i < h->function_count; i++) give_terms(h->functions + i, data);
  linearize(w, x, start, &now);
  merit = cost(h, x) + penalty(h, now.margins, slacks, &slack);
  if (!isfinite(merit)) return release(w), -1;
  while (iterations < max_iterations && scale >= settings[LEAST_SCALE]) {
    double predicted, new_merit, new_slack, again_slack;
    iterations++;
    is_found = step(w, &now, now.margins, x, scale, candidate, slacks, &predicted);
    if (is_found < 0) return release(w), -2;
    if (!is_found) {
      scale /= 4;
      continue;
    }
    const double decrease = merit - predicted;
    double little = tolerance * (fabs(merit) + 1e-6);
    if (slack > settings[PLAN_TOLERANCE]) little = least(little, settings[LITTLE_SLACK]);
    if (decrease <= little) {
      converged = 1;
      break;
    }
    linearize(w, candidate, start, &there);
    new_merit = cost(h, candidate) + penalty(h, there.margins, slacks, &new_slack);
    const int is_poor = !(merit - new_merit > settings[GOOD_RATIO] * decrease);
    if (is_poor && new_slack > settings[PLAN_TOLERANCE] && isfinite(new_merit)) {
      for (i = 0; i < 2 * h->count; i++) difference[i] = candidate[i] - x[i];
      changes(w, &now, difference, w->corrected);
      for (i = 0; i < h->constraints; i++) w->corrected[i] = there.margins[i] - w->corrected[i];
      is_found = step(w, &now, w->corrected, x, scale, again, slacks, &predicted);
      if (is_found < 0) return release(w), -2;
      if (is_found) {
        linearize(w, again, start, &there);
        const double again_merit =
            cost(h, again) + penalty(h, there.margins, slacks, &again_slack);
        if (again_merit < new_merit) {
          memcpy(candidate, again, size);
          new_merit = again_merit, new_slack = again_slack;
        } else {
          linearize(w, candidate, start, &there);
        }
      }
    }
    const double ratio = isfinite(new_merit) ? (merit - new_merit) / decrease : -INFINITY;
    if (ratio > settings[LEAST_RATIO]) {
      memcpy(x, candidate, size);
      merit = new_merit, slack = new_slack;
      swap(&now, &there);
    }
    if (ratio > settings[GOOD_RATIO]) scale = least(2 * scale, settings[LARGEST_SCALE]);
    else if (ratio < settings[FAIR_RATIO]) scale /= 3;
    if (until_feasible && slack <= settings[PLAN_TOLERANCE]) break;
  }
  memcpy(margins, now.margins, h->constraints * sizeof(double));
  numbers[0] = cost(h, x), numbers[1] = slack, numbers[2] = scale;
  numbers[3] = now.slowest, numbers[4] = converged;
  release(w);
  return iterations;
}

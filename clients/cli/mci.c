/* mci: MCML's input files of version 1.0 (L. Wang, S. Jacques, L. Zheng, "MCML - Monte Carlo modeling
 * of light transport in multi-layered tissues", 1995), and what MCML would estimate, without noise. */
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/eval.h"
#include "core/gauss.h"
#include "core/kernels.h"
#include "core/solver/solver.h"

enum { LINE_BYTES = 512, NAME_BYTES = 256 };

#define RINGS_MAX 1e5
#define TOLERANCE_DEFAULT 1e-3
#define MM_PER_CM 10.0
/* A last layer of at least this thickness is a half space; files write 1e8 cm. */
#define HALF_SPACE_CM 1e5

typedef struct mci_file {
  const char *path;
  FILE *file;
  int line; /* number of the line that was read last */
  char text[LINE_BYTES];
} mci_file;

typedef struct mci_row {
  char run[NAME_BYTES]; /* name of the output file */
  const char *quantity;
  size_t layer;    /* index of the layer, from 1; 0: no layer */
  double from, to; /* edges of the ring in cm; NAN: no ring */
  transport_number value;
} mci_row;

typedef struct mci_rows {
  size_t count;
  mci_row *items;
} mci_rows;

/* ---- reading --------------------------------------------------------------------------------- */

/* Reads the next line that is not empty, without its comment. */
static bool read_line(mci_file *in) {
  do {
    if (fgets(in->text, sizeof in->text, in->file) == NULL) {
      in->text[0] = '\0';
      return false;
    }
    in->line++;
    in->text[strcspn(in->text, "#\r\n")] = '\0';
  } while (in->text[strspn(in->text, " \t")] == '\0');
  return true;
}

/* Reads a line of `count` numbers. Otherwise reports `expected` and returns false. */
static bool read_numbers(mci_file *in, size_t count, double numbers[], const char *expected) {
  char *at = in->text;
  size_t read = 0;
  if (read_line(in)) {
    for (char *end; read < count && (numbers[read] = strtod(at, &end), end != at); at = end) {
      read++;
    }
  }
  if (read < count || at[strspn(at, " \t")] != '\0') {
    return cli_fails("%s:%d: '%s': expected %s", in->path, in->line, in->text, expected);
  }
  return true;
}

/* One run that a file describes. */
typedef struct mci_run {
  char name[NAME_BYTES];
  double dr_cm, rings, above, below;
  size_t count;
  solver_layer layer[SOLVER_LAYERS_MAX];
} mci_run;

static bool read_run(mci_file *in, mci_run *run) {
  double photons, cell[2], counts[3], layers, numbers[5];
  if (!read_line(in) || sscanf(in->text, "%255s", run->name) != 1) {
    return cli_fails("%s:%d: a run is missing: expected the name of its output file", in->path,
                     in->line);
  }
  if (!read_numbers(in, 1, &photons, "the number of photons") ||
      !read_numbers(in, 2, cell, "dz and dr, in cm") ||
      !read_numbers(in, 3, counts, "the numbers of dz, dr and da") ||
      !read_numbers(in, 1, &layers, "the number of layers") ||
      !read_numbers(in, 1, &run->above, "n of the medium above")) {
    return false;
  }
  run->dr_cm = cell[1];
  run->rings = counts[1];
  if (!(run->rings >= 1 && run->rings <= RINGS_MAX && run->dr_cm > 0)) {
    return cli_fails("%s:%d: give a dr above 0, and 1 to 1e5 of them", in->path, in->line);
  }
  if (!(layers >= 1 && layers <= SOLVER_LAYERS_MAX)) {
    return cli_fails("%s:%d: %g layers: allowed: 1 to %d", in->path, in->line, layers,
                     SOLVER_LAYERS_MAX);
  }
  for (run->count = 0; run->count < (size_t)layers; run->count++) {
    if (!read_numbers(in, 5, numbers, "n, mua, mus, g and d of a layer, in cm")) {
      return false;
    }
    const bool endless = run->count + 1 == (size_t)layers && numbers[4] >= HALF_SPACE_CM;
    run->layer[run->count] = (solver_layer){
        .sigma_a_per_mm = numbers[1] / MM_PER_CM,
        .sigma_s_per_mm = numbers[2] / MM_PER_CM,
        .g = numbers[3],
        .eta = numbers[0] / run->above,
        .thickness_mm = endless ? (double)INFINITY : numbers[4] * MM_PER_CM,
    };
  }
  return read_numbers(in, 1, &run->below, "n of the medium below");
}

/* ---- what MCML would estimate, per unit of power that was launched ----------------------------- */

static void add_row(mci_rows *rows, const mci_run *run, const char *quantity, size_t layer,
                    double from, double to, transport_number value, double scale) {
  rows->items = cli_resize(rows->items, rows->count + 1, sizeof *rows->items);
  mci_row *row = &rows->items[rows->count++];
  *row = (mci_row){.quantity = quantity, .layer = layer, .from = from, .to = to};
  row->value = (transport_number){value.value * scale, value.error * scale};
  snprintf(row->run, sizeof row->run, "%s", run->name);
}

/* Adds the integral over a ring to *sum, from the inside out. Within a piece that a rule integrates,
 * the radius at most doubles and R falls by a factor of at most FALL. What lies beyond a piece so
 * dark that it hardly counts is part of the error. */
static void add_ring(transport_number *sum, const solver_layers *solution, size_t side,
                     double from_mm, double to_mm, int halvings) {
  enum { NODES = 2 * CORE_GAUSS_HALF };
  const double FALL = 100, DARK = 1e-9, width_mm = to_mm - from_mm;
  transport_number piece = {0, 0};
  double least = (double)INFINITY;
  double most = from_mm > 0 ? solver_layers_at(solution, side, from_mm).value : 0;
  for (int i = 0; i < NODES; i++) {
    const double r_mm = from_mm + width_mm * core_gauss_node(i);
    const double weight = 2 * acos(-1) * r_mm * width_mm * core_gauss_weight(i);
    const transport_number R = solver_layers_at(solution, side, r_mm);
    piece.value += weight * R.value;
    piece.error += weight * R.error;
    least = fmin(least, R.value);
    most = fmax(most, R.value);
  }
  const double bound = most * acos(-1) * width_mm * (to_mm + from_mm);
  const bool dark = from_mm > 0 && bound <= fmax(DARK * sum->value, 0.01 * sum->error);
  if (dark || halvings == 0 || (2 * from_mm >= to_mm && most <= FALL * least)) {
    sum->value += piece.value;
    sum->error += piece.error + (dark ? bound : 0);
    return;
  }
  const double middle_mm = from_mm + width_mm / 2;
  add_ring(sum, solution, side, from_mm, middle_mm, halvings - 1);
  add_ring(sum, solution, side, middle_mm, to_mm, halvings - 1);
}

/* Returns the mean over a ring, per mm^2. Light that was not scattered leaves at r = 0. */
static transport_number ring_mean(const solver_layers *solution, size_t side, double from_mm,
                                  double to_mm, double unscattered) {
  const double area_mm2 = acos(-1) * (to_mm - from_mm) * (to_mm + from_mm);
  transport_number sum = {from_mm > 0 ? 0 : unscattered, 0};
  add_ring(&sum, solution, side, from_mm, to_mm, 24);
  return (transport_number){sum.value / area_mm2, sum.error / area_mm2};
}

static void add_rows(mci_rows *rows, const mci_run *run, const solver_layers *solution,
                     const solver_balance *balance) {
  static const char *const totals[] = {"Rd", "Tt"}, *const rings[] = {"Rd_r", "Tt_r"};
  const double none = (double)NAN;
  const double eta = run->layer[0].eta, amplitude = (eta - 1) / (eta + 1);
  const double entered = 1 - amplitude * amplitude;
  const bool endless = isinf(run->layer[run->count - 1].thickness_mm);
  add_row(rows, run, "Rsp", 0, none, none, (transport_number){1 - entered, 0}, 1);
  for (size_t side = 0; side < SOLVER_SIDES; side++) {
    transport_number all = balance->out[side];
    all.value += balance->unscattered[side];
    add_row(rows, run, totals[side], 0, none, none, all, entered);
  }
  for (size_t i = 0; i < run->count; i++) {
    add_row(rows, run, "A", i + 1, none, none, balance->absorbed[i], entered);
  }
  for (size_t side = 0; side < (endless ? 1 : SOLVER_SIDES); side++) {
    for (size_t i = 0; i < (size_t)run->rings; i++) {
      const double from = (double)i * run->dr_cm, to = (double)(i + 1) * run->dr_cm;
      add_row(
          rows, run, rings[side], 0, from, to,
          ring_mean(solution, side, from * MM_PER_CM, to * MM_PER_CM, balance->unscattered[side]),
          entered * MM_PER_CM * MM_PER_CM);
    }
  }
}

static bool evaluate_run(mci_file *in, const mci_run *run, double tolerance, mci_rows *rows) {
  const core_isa *isa = core_isa_select(NULL);
  solver_layers *solution;
  solver_balance balance;
  core_fault fault = solver_layers_solve(&solution, isa, run->layer, run->count,
                                         run->below / run->above, tolerance, NULL);
  if (fault.field == NULL) {
    fault = solver_layers_balance(solution, isa, &balance);
  }
  if (fault.field == NULL) {
    add_rows(rows, run, solution, &balance);
  } else {
    cli_fail("%s: run %s: layer %zu: %s: allowed: %s", in->path, run->name, fault.index + 1,
             fault.field, fault.allowed);
  }
  solver_layers_free(solution);
  return fault.field == NULL;
}

/* ---- the command ----------------------------------------------------------------------------- */

static void put_row(cli_rows *rows, const void *context, size_t index) {
  const mci_row *row = &((const mci_rows *)context)->items[index];
  const double layer = row->layer > 0 ? (double)row->layer : (double)NAN;
  cli_put_text(rows, row->run, "run");
  cli_put_text(rows, row->quantity, "quantity");
  cli_put_number(rows, layer, "layer", .missing = "");
  cli_put_number(rows, cli_number_rounded(row->from), "from", .unit = "cm", .missing = "");
  cli_put_number(rows, cli_number_rounded(row->to), "to", .unit = "cm", .missing = "");
  cli_put_number(rows, row->value.value, "value", .format = "%.5e", .below = "1, 1/cm^2");
  cli_put_number(rows, row->value.error, "error", .format = "%.1e", .below = "1, 1/cm^2");
}

int cli_mci(const cli_settings *settings) {
  const cli_given *tolerance = &settings->parameters[CORE_PARAMETER_TOLERANCE];
  mci_file in = {.path = settings->mci, .file = fopen(settings->mci, "r")};
  mci_rows rows = {0};
  double version, runs = 0;
  if (in.file == NULL) {
    return cli_fail("%s: %s", in.path, strerror(errno));
  }
  bool good = read_numbers(&in, 1, &version, "1.0, the version of MCML's input files") &&
              read_numbers(&in, 1, &runs, "the number of runs");
  for (double i = 0; good && i < runs; i++) {
    mci_run run = {0};
    good = read_run(&in, &run) &&
           evaluate_run(&in, &run, tolerance->text != NULL ? tolerance->value : TOLERANCE_DEFAULT,
                        &rows);
  }
  fclose(in.file);
  if (good) {
    cli_write(&(const cli_report){.rows = rows.count, .put_row = put_row, .left = 2},
              settings->form, &rows);
  }
  return good ? CLI_OK : CLI_FAILED;
}

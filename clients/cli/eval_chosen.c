/* Writes what a tolerance has chosen and why, and the cheaper offers that it did not choose. */
#include <math.h>
#include <stdlib.h>

#include "clients/cli/daemon.h"
#include "clients/cli/eval.h"
#include "clients/cli/number.h"
#include "clients/cli/rows.h"

/* How many cheaper offers are listed for people. */
enum { LISTED_MAX = 4 };

bool cli_eval_is_chosen(const cli_eval_report *report) {
  return report->chosen_from.offers != NULL;
}

static const char *name_of(const cli_eval_report *report, enum dipole_kind kind, unsigned id) {
  const dipole_choice *choice = cli_choice_of_id(report->profile.info, kind, id);
  return choice != NULL ? choice->name : "?";
}

/* Returns the offer that was taken; NULL if the daemon has taken one that it had not offered. */
static const dipole_offer *find_taken(const cli_eval_report *report) {
  const cli_eval_offers *from = &report->chosen_from;
  for (size_t i = 0; i < from->count; i++) {
    if (from->offers[i].model == report->models[0].choice->id &&
        from->offers[i].evaluator == report->profile.evaluator->id) {
      return &from->offers[i];
    }
  }
  return NULL;
}

static bool is_cheaper_and_off(const dipole_offer *offer, const dipole_offer *taken) {
  return !offer->meets && offer->cost_ns < taken->cost_ns;
}

/* ---- for people ---------------------------------------------------------------------------- */

static void write_range(const cli_eval_report *report, FILE *file) {
  double least = (double)INFINITY, most = 0;
  for (size_t i = 0; i < report->radius_count; i++) {
    least = fmin(least, report->radii[i]);
    most = fmax(most, report->radii[i]);
  }
  if (report->radius_count > 0 && least < most) {
    fprintf(file, " from %.6g to %.6g mm", least, most);
  } else if (report->radius_count > 0) {
    fprintf(file, " at %.6g mm", least);
  }
}

/* Returns a bound in two digits, rounded up so that it stays a bound. */
static double rounded_up(double bound) {
  const double unit = pow(10, floor(log10(bound)) - 1);
  return bound > 0 && bound < (double)INFINITY ? unit * ceil(bound / unit * (1 - 1e-12)) : bound;
}

/* Returns whether people see an offer in the list: it is cheaper, misses the tolerance, and is the
 * first such offer of its model. */
static bool is_listed(const cli_eval_offers *from, const dipole_offer *offer,
                      const dipole_offer *taken) {
  bool listed = is_cheaper_and_off(offer, taken);
  for (const dipole_offer *before = from->offers; before < offer; before++) {
    listed = listed && before->model != offer->model;
  }
  return listed;
}

/* Orders offers by error and, where that is the same, by cost; a NaN comes last. */
static int compare(const void *a, const void *b) {
  const dipole_offer *x = *(const dipole_offer *const *)a, *y = *(const dipole_offer *const *)b;
  const double x_error = isnan(x->error) ? (double)INFINITY : x->error;
  const double y_error = isnan(y->error) ? (double)INFINITY : y->error;
  return x_error != y_error ? (x_error > y_error) - (x_error < y_error) : (x > y) - (x < y);
}

/* Writes, for example, "; cheaper and not within 0.01: better (f32) 0.24 and 3 more". */
static void write_cheaper(const cli_eval_report *report, const dipole_offer *taken, FILE *file) {
  const cli_eval_offers *from = &report->chosen_from;
  const dipole_offer **listed = cli_allocate(from->count, sizeof(const dipole_offer *));
  char text[CLI_NUMBER_BYTES];
  size_t count = 0, written = 0;
  for (size_t i = 0; i < from->count; i++) {
    if (is_listed(from, &from->offers[i], taken)) {
      listed[count++] = &from->offers[i];
    }
  }
  qsort(listed, count, sizeof *listed, compare);
  if (count > 0) {
    fprintf(file, "; cheaper and not within %s: ", cli_number_format(from->tolerance, text));
  }
  for (; written < count && written < LISTED_MAX && listed[written]->error < (double)INFINITY;
       written++) {
    fprintf(file, "%s%s (%s) %.2g", written > 0 ? ", " : "",
            name_of(report, DIPOLE_MODEL, listed[written]->model),
            name_of(report, DIPOLE_EVALUATOR, listed[written]->evaluator), listed[written]->error);
  }
  if (written == 0 && count > 0) {
    fprintf(file, "%zu whose error is not known here", count);
  } else if (count > written) {
    fprintf(file, " and %zu more", count - written);
  }
  free(listed);
}

void cli_eval_write_chosen(const cli_eval_report *report, FILE *file) {
  if (!cli_eval_is_chosen(report)) {
    return;
  }
  const dipole_offer *taken = find_taken(report);
  fprintf(file, "took %s%s (%s)", report->models[0].choice->name,
          report->profile.evaluator->id == DIPOLE_LUT ? " by table" : "",
          report->profile.evaluator->name);
  if (taken != NULL) {
    fprintf(file, ": within %.2g of transport", rounded_up(taken->error));
    write_range(report, file);
    fprintf(file, ", %.2g ns a value", taken->cost_ns);
    write_cheaper(report, taken, file);
  }
  fputc('\n', file);
}

/* ---- JSON ---------------------------------------------------------------------------------- */

/* Returns NaN, which JSON shows as null, for an error that is not known. */
static double known(double error) {
  return error < (double)INFINITY ? error : (double)NAN;
}

typedef struct offers {
  const cli_eval_report *report;
  const dipole_offer *items;
} offers;

static void put_offer(cli_rows *rows, const void *context, size_t index) {
  const offers *of = context;
  const dipole_offer *offer = &of->items[index];
  cli_put_text(rows, CLI_COLUMN("model"), name_of(of->report, DIPOLE_MODEL, offer->model));
  cli_put_text(rows, CLI_COLUMN("evaluator"),
               name_of(of->report, DIPOLE_EVALUATOR, offer->evaluator));
  cli_put_number(rows, CLI_COLUMN("error"), known(offer->error));
  cli_put_number(rows, CLI_COLUMN("numerical_error"), known(offer->numerical_error));
  cli_put_number(rows, CLI_COLUMN("cost_ns"), offer->cost_ns);
  cli_put_number(rows, CLI_COLUMN("prepare_ns"), offer->prepare_ns);
}

void cli_eval_write_chosen_json(const cli_eval_report *report, cli_json *json) {
  if (!cli_eval_is_chosen(report)) {
    return;
  }
  const cli_eval_offers *from = &report->chosen_from;
  const dipole_offer *taken = find_taken(report);
  cli_json_begin(json, "chosen", '{');
  cli_json_number(json, "tolerance", from->tolerance);
  if (taken != NULL) {
    cli_rows_members(json, put_offer, &(const offers){report, taken}, 0);
  }
  cli_json_begin(json, "cheaper", '[');
  for (size_t i = 0; taken != NULL && i < from->count; i++) {
    if (is_cheaper_and_off(&from->offers[i], taken)) {
      cli_json_begin(json, NULL, '{');
      cli_rows_members(json, put_offer, &(const offers){report, from->offers}, i);
      cli_json_end(json, '}');
    }
  }
  cli_json_end(json, ']');
  cli_json_end(json, '}');
}

/* What a tolerance has chosen, why, and what it did not choose. */
#include <math.h>

#include "clients/cli/eval.h"
#include "clients/cli/number.h"

/* Cheaper ones that people are told of. */
enum { TOLD_MAX = 4 };

bool cli_eval_is_chosen(const cli_eval_report *report) {
  return report->chosen_from.offers != NULL;
}

static const char *name_of(const cli_eval_report *report, enum dipole_kind kind, unsigned id) {
  const dipole_choice *choice = cli_choice_of_id(report->info, kind, id);
  return choice != NULL ? choice->name : "?";
}

/* The offer that was taken; NULL: the daemon has taken one that it had not offered. */
static const dipole_offer *find_taken(const cli_eval_report *report) {
  const cli_eval_offers *from = &report->chosen_from;
  for (size_t i = 0; i < from->count; i++) {
    if (from->offers[i].model == report->models[0].choice->id &&
        from->offers[i].evaluator == report->evaluator->id) {
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

/* A bound in two digits, which must not make it less. */
static double rounded_up(double bound) {
  const double unit = pow(10, floor(log10(bound)) - 1);
  return bound > 0 && bound < (double)INFINITY ? unit * ceil(bound / unit * (1 - 1e-12)) : bound;
}

/* Whether people are told of an offer: one that is cheaper and off, of each model the cheapest. */
static bool is_worth_telling(const cli_eval_offers *from, const dipole_offer *offer,
                             const dipole_offer *taken) {
  bool worth = is_cheaper_and_off(offer, taken);
  for (const dipole_offer *before = from->offers; before < offer; before++) {
    worth = worth && before->model != offer->model;
  }
  return worth;
}

/* Whether one of the cheaper ones has a smaller error, or the same and comes first. */
static bool is_nearer(const dipole_offer *a, const dipole_offer *b) {
  return a->error < b->error || (!(b->error < a->error) && a < b);
}

/* The nearest of the cheaper ones beyond the last that was told; NULL: none whose error is known.
 */
static const dipole_offer *next_nearest(const cli_eval_offers *from, const dipole_offer *taken,
                                        const dipole_offer *last) {
  const dipole_offer *next = NULL;
  for (const dipole_offer *offer = from->offers; offer < from->offers + from->count; offer++) {
    if (is_worth_telling(from, offer, taken) && offer->error < (double)INFINITY &&
        (last == NULL || is_nearer(last, offer)) && (next == NULL || is_nearer(offer, next))) {
      next = offer;
    }
  }
  return next;
}

/* "; cheaper and not within 0.01: better (f32) 0.24, burley (f32) 0.61 and 3 more" */
static void write_cheaper(const cli_eval_report *report, const dipole_offer *taken, FILE *file) {
  const cli_eval_offers *from = &report->chosen_from;
  char text[CLI_NUMBER_BYTES];
  size_t told = 0, all = 0;
  for (size_t i = 0; i < from->count; i++) {
    all += is_worth_telling(from, &from->offers[i], taken);
  }
  if (all == 0) {
    return;
  }
  fprintf(file, "; cheaper and not within %s: ", cli_number_format(from->tolerance, text));
  const dipole_offer *offer = next_nearest(from, taken, NULL);
  for (; offer != NULL && told < TOLD_MAX; offer = next_nearest(from, taken, offer)) {
    fprintf(file, "%s%s (%s) %.2g", told > 0 ? ", " : "",
            name_of(report, DIPOLE_MODEL, offer->model),
            name_of(report, DIPOLE_EVALUATOR, offer->evaluator), offer->error);
    told++;
  }
  if (told == 0) {
    fprintf(file, "%zu whose error is not known here", all);
  } else if (all > told) {
    fprintf(file, " and %zu more", all - told);
  }
}

void cli_eval_write_chosen(const cli_eval_report *report, FILE *file) {
  if (!cli_eval_is_chosen(report)) {
    return;
  }
  const dipole_offer *taken = find_taken(report);
  fprintf(file, "took %s%s (%s)", report->models[0].choice->name,
          report->evaluator->id == DIPOLE_LUT ? " by table" : "", report->evaluator->name);
  if (taken != NULL) {
    fprintf(file, ": within %.2g of transport", rounded_up(taken->error));
    write_range(report, file);
    fprintf(file, ", %.2g ns a value", taken->cost_ns);
    write_cheaper(report, taken, file);
  }
  fputc('\n', file);
}

/* ---- JSON ---------------------------------------------------------------------------------- */

static void write_json_offer(const cli_eval_report *report, const dipole_offer *offer,
                             cli_json *json) {
  cli_json_text(json, "model", name_of(report, DIPOLE_MODEL, offer->model));
  cli_json_text(json, "evaluator", name_of(report, DIPOLE_EVALUATOR, offer->evaluator));
  cli_json_number(json, "error", offer->error);
  cli_json_number(json, "numerical_error", offer->numerical_error);
  cli_json_number(json, "cost_ns", offer->cost_ns);
  cli_json_number(json, "prepare_ns", offer->prepare_ns);
}

/* Errors that are not known are null here, as those that have not been measured are elsewhere. */
static dipole_offer with_unknown(dipole_offer offer) {
  offer.error = offer.error < (double)INFINITY ? offer.error : (double)NAN;
  offer.numerical_error =
      offer.numerical_error < (double)INFINITY ? offer.numerical_error : (double)NAN;
  return offer;
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
    const dipole_offer known = with_unknown(*taken);
    write_json_offer(report, &known, json);
  }
  cli_json_begin(json, "cheaper", '[');
  for (size_t i = 0; taken != NULL && i < from->count; i++) {
    if (is_cheaper_and_off(&from->offers[i], taken)) {
      const dipole_offer known = with_unknown(from->offers[i]);
      cli_json_begin(json, NULL, '{');
      write_json_offer(report, &known, json);
      cli_json_end(json, '}');
    }
  }
  cli_json_end(json, ']');
  cli_json_end(json, '}');
}

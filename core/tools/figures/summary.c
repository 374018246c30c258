#include "core/tools/figures/summary.h"

#include <math.h>
#include <stdlib.h>

#include "core/tools/figures/table.h"
#include "core/tools/tools.h"

enum { PANELS_MAX = PANEL_RATIOS * PANEL_ETAS };

/* The models that are compared. The abstract of d'Eon 2012 says that the better dipole improves
 * upon the classical one and is less accurate than quantized diffusion. The other pairs are added.
 */
static const struct pair {
  size_t model, against;
} pairs[] = {
    {COLUMN_BETTER, COLUMN_CLASSICAL},        {COLUMN_BETTER_SINGLE, COLUMN_CLASSICAL_SINGLE},
    {COLUMN_BETTER_SINGLE, COLUMN_BETTER},    {COLUMN_QUANTIZED, COLUMN_CLASSICAL},
    {COLUMN_QUANTIZED, COLUMN_BETTER},        {COLUMN_QUANTIZED_SINGLE, COLUMN_CLASSICAL},
    {COLUMN_QUANTIZED_SINGLE, COLUMN_BETTER}, {COLUMN_QUANTIZED_SINGLE, COLUMN_BETTER_SINGLE},
};
enum { PAIRS = sizeof pairs / sizeof pairs[0] };

static const struct group {
  double ratio_least, ratio_most; /* sigma_a / sigma_s' */
  double eta_least, eta_most;
} groups[] = {
    {0, 100, 1, 2},   {0, 0.011, 1, 2},  {0.011, 0.6, 1, 2},
    {0.6, 100, 1, 2}, {0, 100, 1, 1.41}, {0, 100, 1.41, 2},
};
enum { GROUPS = sizeof groups / sizeof groups[0] };

typedef struct range {
  double from, to; /* mean free paths; both are NaN for the albedo */
} range;

static const range ranges[] = {
    {PANEL_R_LEAST, PANEL_R_MOST}, {PANEL_R_LEAST, 0.1}, {0.1, 1}, {1, 5}, {5, PANEL_R_MOST}};
enum { RANGES = sizeof ranges / sizeof ranges[0] };

/* ---- how far off ------------------------------------------------------------------------------
 */

/* Returns the logarithm of the factor by which a column deviates from transport. */
static double off(const panel_data *medium, size_t column, range over) {
  double sum = 0;
  size_t radii = 0;
  if (isnan(over.from)) {
    return fabs(log(medium->albedo[column] / medium->albedo[COLUMN_TRANSPORT]));
  }
  for (size_t i = 0; i < PANEL_RINGS; i++) {
    const double r = panel_radius(i);
    if (r >= over.from && r <= over.to) {
      sum += fabs(log(medium->value[column][i] / medium->value[COLUMN_TRANSPORT][i]));
      radii++;
    }
  }
  return sum / (double)radii;
}

static bool in_group(const panel_data *medium, struct group group) {
  const double ratio = panel_ratio(medium), eta = panel_eta(medium);
  return ratio >= group.ratio_least && ratio <= group.ratio_most && eta >= group.eta_least &&
         eta <= group.eta_most;
}

typedef struct verdict {
  size_t panels, nearer;
  double median[2], worst[2]; /* factors of [0] the model and [1] the other of the pair */
} verdict;

static verdict judge(const panel_data *const *panels, size_t count, struct pair pair,
                     struct group group, range over) {
  double offs[2][PANELS_MAX];
  verdict v = {0};
  for (size_t i = 0; i < count; i++) {
    if (in_group(panels[i], group)) {
      offs[0][v.panels] = off(panels[i], pair.model, over);
      offs[1][v.panels] = off(panels[i], pair.against, over);
      v.nearer += offs[0][v.panels] < offs[1][v.panels];
      v.panels++;
    }
  }
  for (size_t k = 0; k < 2 && v.panels > 0; k++) {
    v.median[k] = exp(tools_median(offs[k], v.panels));
    v.worst[k] = exp(offs[k][v.panels - 1]);
  }
  return v;
}

/* ---- the table --------------------------------------------------------------------------------
 */

static void put_row(FILE *file, const panel_data *const *panels, size_t count, struct pair pair,
                    struct group group, range over) {
  const verdict v = judge(panels, count, pair, group, over);
  struct group held = {(double)INFINITY, 0, (double)INFINITY,
                       0}; /* the range of the panels that were computed */
  if (v.panels == 0) {
    return;
  }
  for (size_t i = 0; i < count; i++) {
    if (in_group(panels[i], group)) {
      held.ratio_least = fmin(held.ratio_least, panel_ratio(panels[i]));
      held.ratio_most = fmax(held.ratio_most, panel_ratio(panels[i]));
      held.eta_least = fmin(held.eta_least, panel_eta(panels[i]));
      held.eta_most = fmax(held.eta_most, panel_eta(panels[i]));
    }
  }
  fprintf(file, "%s,%s,%g,%g,%g,%g", panel_column_name(pair.model), panel_column_name(pair.against),
          held.ratio_least, held.ratio_most, held.eta_least, held.eta_most);
  table_put(file, over.from);
  table_put(file, over.to);
  fprintf(file, ",%zu,%zu,%.4f,%.5g,%.5g,%.5g,%.5g\n", v.panels, v.nearer,
          (double)v.nearer / (double)v.panels, v.median[0], v.median[1], v.worst[0], v.worst[1]);
}

static const range the_albedo = {(double)NAN, (double)NAN};

void summary_write(const char *path, const panel_data *const *panels, size_t count) {
  FILE *file = tools_open(path);
  fputs("model,against,ratio_from,ratio_to,eta_from,eta_to,r_from,r_to,panels,nearer,share,model_"
        "median,"
        "against_median,model_worst,against_worst\n",
        file);
  for (size_t p = 0; p < PAIRS; p++) {
    for (size_t g = 0; g < GROUPS; g++) {
      put_row(file, panels, count, pairs[p], groups[g], the_albedo);
      for (size_t i = 0; i < RANGES; i++) {
        put_row(file, panels, count, pairs[p], groups[g], ranges[i]);
      }
    }
    for (size_t i = 0; i < PANEL_RINGS; i++) {
      put_row(file, panels, count, pairs[p], groups[0], (range){panel_radius(i), panel_radius(i)});
    }
  }
  tools_close(file, path);
}

/* ---- Monte Carlo against transport ------------------------------------------------------------
 */

#define CHECK_ERROR_MAX 0.05

typedef struct check {
  size_t rings;
  double chi2, worst, albedo;
} check;

static check check_panel(const panel_data *medium) {
  check c = {0};
  for (size_t i = 0; i < PANEL_RINGS; i++) {
    const double R = medium->value[COLUMN_MONTE_CARLO][i];
    const double error = medium->value[COLUMN_MONTE_CARLO_ERROR][i];
    if (R > 0 && error < CHECK_ERROR_MAX * R) {
      const double sigmas = (R - medium->value[COLUMN_TRANSPORT_RING][i]) / error;
      c.rings++;
      c.chi2 += sigmas * sigmas;
      c.worst = fmax(c.worst, fabs(sigmas));
    }
  }
  c.albedo = (medium->albedo[COLUMN_MONTE_CARLO] - medium->albedo[COLUMN_TRANSPORT]) /
             medium->albedo[COLUMN_MONTE_CARLO_ERROR];
  return c;
}

void summary_write_check(const char *path, const panel_data *const *panels, size_t count,
                         uint64_t batches) {
  FILE *file = tools_open(path);
  fputs("ratio,eta,rings,chi2,worst_sigmas,albedo_sigmas\n", file);
  for (size_t i = 0; i < count && batches >= SUMMARY_CHECK_BATCHES_MIN; i++) {
    if (panels[i]->known[PANEL_WALK]) {
      const check c = check_panel(panels[i]);
      fprintf(file, "%s,%s,%zu,%.4g,%.3g,%.3g\n", panel_ratio_names[panels[i]->ratio],
              panel_eta_names[panels[i]->eta], c.rings, c.chi2, c.worst, c.albedo);
    }
  }
  tools_close(file, path);
}

/* ---- for people -------------------------------------------------------------------------------
 */

static void print_check(FILE *out, const panel_data *const *panels, size_t count,
                        uint64_t batches) {
  check all = {0};
  for (size_t i = 0; i < count && batches >= SUMMARY_CHECK_BATCHES_MIN; i++) {
    if (panels[i]->known[PANEL_WALK]) {
      const check c = check_panel(panels[i]);
      all.rings += c.rings;
      all.chi2 += c.chi2;
      all.worst = fmax(all.worst, c.worst);
      all.albedo = fmax(all.albedo, fabs(c.albedo));
    }
  }
  if (all.rings > 0) {
    fprintf(out,
            "Monte Carlo against transport: %zu rings known to 5 %%, chi2 / rings %.3f, worst %.1f "
            "standard errors; albedos, worst %.1f\n",
            all.rings, all.chi2 / (double)all.rings, all.worst, all.albedo);
  }
}

void summary_print(FILE *out, const panel_data *const *panels, size_t count, uint64_t batches) {
  print_check(out, panels, count, batches);
  fprintf(out, "nearer to transport, in panels; median factor by which they are off:\n");
  for (size_t p = 0; p < PAIRS; p++) {
    fprintf(out, "  %s, not %s:\n", panel_column_name(pairs[p].model),
            panel_column_name(pairs[p].against));
    for (size_t i = 0; i <= RANGES; i++) {
      const range over = i < RANGES ? ranges[i] : the_albedo;
      const verdict v = judge(panels, count, pairs[p], groups[0], over);
      char where[32] = "albedo";
      if (i < RANGES) {
        snprintf(where, sizeof where, "r %g to %g", over.from, over.to);
      }
      fprintf(out, "    %-14s %3zu of %3zu  %6.3f  %6.3f\n", where, v.nearer, v.panels, v.median[0],
              v.median[1]);
    }
  }
}

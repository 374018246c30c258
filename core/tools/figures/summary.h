/* summary: which model is nearer to transport, in how many panels, by how much, at which radii; and
 * whether Monte Carlo agrees with transport.
 *
 * How far off a model is at a radius is the factor between its R and transport's, whichever is
 * larger over the other, so that half and double are as far off; over several radii, which are
 * spaced evenly in ln r, the geometric mean of the factors. */
#ifndef FIGURES_SUMMARY_H
#define FIGURES_SUMMARY_H

#include <stdio.h>

#include "core/tools/figures/panel.h"

/* A row for each pair of models, group of panels (from the least to the most ratio and eta that
 * are there), and range of radii, single radii included (r_from and r_to are equal then), and the
 * albedo (r_from and r_to are empty then):
 *   panels, nearer        how many there are, and in how many of them the model is nearer
 *   share                 nearer / panels
 *   model_median, against_median, model_worst, against_worst    factors, over the panels */
void summary_write(const char *path, const panel_data *const *panels, size_t count);

/* With fewer batches the estimated errors are too uncertain to tell which rings are well known. */
#define SUMMARY_CHECK_BATCHES_MIN 30

/* A row for each panel with Monte Carlo of at least so many batches: chi2 over the rings whose
 * standard error is below 5 %, how many they are, and the worst deviation and that of the albedo in
 * standard errors. */
void summary_write_check(const char *path, const panel_data *const *panels, size_t count,
                         uint64_t batches);

/* The gist of both, for people. */
void summary_print(FILE *out, const panel_data *const *panels, size_t count, uint64_t batches);

#endif

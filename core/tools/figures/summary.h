/* summary: finds which model is nearer to transport, in how many panels, by how much and at which
 * radii. It also checks that Monte Carlo agrees with transport.
 *
 * The deviation of a model at a radius is the larger of R / R_transport and its inverse, so half
 * and double count the same. Over several radii, which are spaced evenly in ln r, it is the
 * geometric mean of these factors. */
#ifndef FIGURES_SUMMARY_H
#define FIGURES_SUMMARY_H

#include <stdio.h>

#include "core/tools/figures/panel.h"

/* Writes a CSV file with a row for each pair of models, group of panels and range of radii. A group
 * is named by its least and largest ratio and eta. For a single radius r_from and r_to are equal;
 * for the albedo they are empty. The other columns are:
 *   panels                the number of panels in the group
 * nearer                the number of those in which the model is nearer
 *   share                 nearer / panels
 *   model_median, against_median, model_worst, against_worst    factors, over the panels */
void summary_write(const char *path, const panel_data *const *panels, size_t count);

/* With fewer batches the errors that Monte Carlo states are too uncertain for a check. */
#define SUMMARY_CHECK_BATCHES_MIN 30

/* Writes a CSV file with a row for each panel that has Monte Carlo values, if `batches` is at least
 * SUMMARY_CHECK_BATCHES_MIN. A row has chi2 over the rings whose standard error is below 5 %, the
 * number of these rings, and in standard errors their worst deviation and the albedo's. */
void summary_write_check(const char *path, const panel_data *const *panels, size_t count,
                         uint64_t batches);

/* Prints the main results of summary_write() and summary_write_check() as text. */
void summary_print(FILE *out, const panel_data *const *panels, size_t count, uint64_t batches);

#endif

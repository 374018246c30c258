/* table_case: media to try tables at, and one table beside the model that it stands for. */
#ifndef DIPOLED_TABLE_CASE_H
#define DIPOLED_TABLE_CASE_H

#include "core/core.h"

/* A medium, and for slabs a thickness in mean free paths 1 / sigma_t'. */
struct table_place {
  core_medium medium;
  double thickness_mfp;
};

/* Media as they are met with: measured ones, and a grid of eta and absorption. Their order is
 * arbitrary, so that any few neighbours are a fair choice. */
size_t table_ordinary_count(void);
struct table_place table_ordinary(size_t index);

/* Media at the ends of the domain, one end each, and in its corners. */
extern const struct table_place table_extremes[];
extern const size_t table_extremes_count;

/* 1 / (sigma_a + sigma_s (1 - g)) */
double table_mfp_mm(const core_medium *medium);

/* Returns the parameters of a model at a place, with the thickness if the model takes one. A
 * tolerance of NAN is left out. */
core_parameters table_parameters(unsigned model, const struct table_place *place, double tolerance);

/* Prepares the model in double precision with its smallest error. */
core_fault table_truth(core_profile *truth, unsigned model, const struct table_place *place);

core_fault table_prepare(core_profile *table, unsigned model, const struct table_place *place,
                         double tolerance);

/* Returns whether a model takes a tolerance, so that the tolerance of a table's source matters. */
bool table_is_approximate(unsigned model);

/* What is left of an error when what core.h allows for underflow is forgiven: of `value` in single
 * precision, relative to the truth. */
double table_error(float value, double truth);

#endif

/* inverse: the start of a fit of two readings, from a table of the inverse of the model, where it is
 * shown that no second medium fits. Internal to core/fit.
 *
 * Two readings of known scale map a medium (ln ratio, ln scattering) to a point of the plane of the
 * readings' logarithms. The table is a raster of that plane. A cell of it is simple if exactly one
 * medium maps to its centre, if the map's determinant does not vanish at any medium that maps into
 * the cell, and if no medium on a bound of the search does. Then every point of the cell comes from
 * exactly one medium.
 *
 * A medium at which chi-squared is least among its neighbours makes chi-squared 0, or lies on a
 * bound, or makes the determinant vanish. If chi-squared there is below CORE_FIT_AMBIGUOUS, the
 * medium maps into a rectangle around the readings. So if all cells that the rectangle touches are
 * simple, one medium fits, and there is no second solution below that limit.
 */
#ifndef DIPOLED_CORE_FIT_INVERSE_H
#define DIPOLED_CORE_FIT_INVERSE_H

#include "core/fit/values.h"

typedef struct fit_inverse fit_inverse;

/* Makes the table for two places, whose model is multiplied by weight[2], and for media between
 * `least` and `most`. Returns false if memory runs out; else the caller frees *inverse with
 * free(). */
bool fit_inverse_create(fit_inverse **inverse, const struct fit_model *model,
                        const struct fit_places *places, const double *weight,
                        struct fit_place least, struct fit_place most);
size_t fit_inverse_bytes(const fit_inverse *inverse);

/* Sets *start to a medium near the one that two readings come from. Returns false unless it is shown
 * that no other medium has a local minimum of chi-squared below CORE_FIT_AMBIGUOUS. */
bool fit_inverse_start(const fit_inverse *inverse, const double *values, const double *errors,
                       struct fit_place *start);

#endif

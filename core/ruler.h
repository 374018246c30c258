/* ruler: computes how far models are from radiative transport.
 *
 * The model error of a request is the largest |R_model / R_transport - 1| at its radii, from the
 * profile of the model `transport` for the same medium, the ruler, with moments `exact`, evaluator
 * `f64` and no parameters. The other quantities are compared
 * in the same way, each with itself. The numerical error that transport states is part of the sum,
 * and so the result is an upper bound for the values of this profile.
 */
#ifndef DIPOLED_CORE_RULER_H
#define DIPOLED_CORE_RULER_H

#include "core/model_error.h"

/* Returns whether core_model_error() needs the ruler for this model and medium and can get it: from
 * the table of solutions, or by solving if `solves`, as slabs always are. There is no ruler for a
 * surface albedo and for gamma. */
bool core_ruler_is_needed(unsigned model, const core_parameters *parameters,
                          const core_medium *medium, bool solves);

/* Returns the model that is the ruler of a model: transport, or that of the light below a slab. */
unsigned core_ruler_of(unsigned model, const core_parameters *parameters);

/* The largest number of radii at which models are compared. If a request has more, this many are
 * chosen. */
enum { CORE_RULER_RADII = 256 };

/* The radii of a request: a grid, or a list of grid.count radii of the evaluator's type. */
typedef struct core_requested_radii {
  core_grid grid;
  const void *listed;     /* the list; NULL: the radii are the grid's */
  core_radii_range range; /* as core_radii_check_f64() sets it */
} core_requested_radii;

/* Sets error[n], n up to CORE_RULER_RADII, to how far the wanted quantities of a profile are from
 * those of the ruler at radii r[n] in mm, in the precision of the profile's evaluator: the largest
 * one, relative, but absolute for ln R and the cdf, and over the albedo for TRANSFER. It is NAN where
 * transport diverges, at r = 0, and if none of the quantities can be compared, as the derivatives of
 * ln R; and INFINITY where nothing is known of transport. transport: as in core_model_error();
 * without transport the errors are those that the model states itself. */
void core_model_errors_at(const core_profile *profile, const core_profile *transport,
                          unsigned wanted, size_t n, const double *r, double *error);

/* Returns the largest of these errors at the finite radii of a request, and of the albedo if it is
 * wanted; NAN if there is none, and INFINITY where nothing is known of transport. transport: the ruler, or NULL if it is not needed or not at hand.
 * Of more than CORE_RULER_RADII radii, some are
 * compared that are at most e^(1/8) apart (more over ranges of more than e^32). Between them the
 * error is taken to be smooth: a quarter of the second differences around is added, which is twice
 * what a parabola rises above its points. */
double core_model_error(const core_profile *profile, const core_profile *transport, unsigned wanted,
                        const core_requested_radii *requested);

/* Returns how far an albedo that a model without parameters has of a half space is from transport's,
 * relative; NAN if that is not known. It takes as long as core_albedo() of transport. */
double core_ruler_albedo_error(const core_isa *isa, unsigned model, const core_medium *medium,
                               double albedo);

/* Returns the errors of a profile in each band; the arguments are those of core_model_error(). */
core_model_errors core_model_errors_measure(const core_profile *profile,
                                            const core_profile *transport);

#endif

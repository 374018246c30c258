/* edge: the light beside a straight edge of shadow, which is what the eye sees of a profile. A half
 * plane is lit; E(x) is the light that leaves at distance x from the edge over that far inside. It
 * rises from 0 in the shadow over 1/2 at the edge to 1, and 1 - E(x) = E(-x). */
#ifndef DIPOLE_CLI_EDGE_H
#define DIPOLE_CLI_EDGE_H

#include "clients/cli/daemon.h"

enum { CLI_EDGE_RADII = 4096 };

/* What a difference of E and of another edge, at some places, may lack of the largest one. */
#define CLI_EDGE_ERROR 6e-5

/* Sets *r_mm to the radii between which equal shares of the light leave, [count][CLI_EDGE_RADII] and
 * ascending, of media[count][layer_count] under transport; colours[count] to their albedos, and
 * errors[count] to the relative errors of R that the daemon states; these may be NULL. Says what is
 * wrong and returns false if that fails. */
bool cli_edge_radii(const cli_settings *settings, dipole_client *client, const dipole_medium *media,
                    uint32_t layer_count, size_t count, double **r_mm, double *colours,
                    double *errors);

/* Returns E at x of a profile with these radii, within 3e-5: 1/2 + mean(asin(min(1, x / r))) / pi,
 * since the share 2 asin(x / r) / pi of a circle lies within x of a line through its middle. */
double cli_edge_at(const double *r_mm, double x_mm);

/* Returns the length d of Burley's profile (Christensen, Burley 2015) whose edge is the nearest to
 * that of these radii, and sets *error to the largest difference of E, unless it is NULL. */
double cli_edge_burley(const double *r_mm, double *error);

#endif

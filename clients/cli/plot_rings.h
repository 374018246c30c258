/* plot_rings: means over rings, for pictures that compare models with Monte Carlo. */
#ifndef DIPOLE_CLI_PLOT_RINGS_H
#define DIPOLE_CLI_PLOT_RINGS_H

#include "clients/cli/eval_report.h"

/* What 2 pi r R at a node adds to a ring's power, and to how far that is off. */
typedef struct cli_weight {
  size_t ring;
  double mm, error_mm;
} cli_weight;

typedef struct cli_rings {
  unsigned spacing; /* of the edges: DIPOLE_LINEAR or DIPOLE_LOGARITHMIC */
  size_t count;
  double *edges_mm; /* [count + 1] */
  size_t node_count;
  double *nodes_mm;    /* [node_count], ring by ring: where 2 pi r R is needed for the means */
  cli_weight *weights; /* [node_count] */
} cli_rings;

/* Makes `count` rings from from_mm to to_mm. Free them with cli_rings_free(). */
cli_rings cli_rings_make(double from_mm, double to_mm, bool logarithmic, size_t count);
void cli_rings_free(cli_rings *rings);

/* Turns a report of 2 pi r R at the nodes, its only quantity, into one of R over the rings. The
 * report's radii are then those that halve the rings' areas, and the numerical errors hold that of
 * the integration: the largest relative change when the parts of a ring are cut into halves. */
void cli_rings_take_means(const cli_rings *rings, cli_eval_report *report);

/* Walks photons through each channel's medium, a half space or a slab of finite thickness, and adds
 * the means over the rings to the report as those of a model `mc`, before a reference that is
 * unlisted, and their standard errors as a second quantity, which is NaN for the other models. Says
 * what is wrong and returns an exit status. */
int cli_rings_walk(const cli_rings *rings, double photons, double thickness_mm,
                   dipole_client *client, cli_eval_report *report);

#endif

#include "core/fit/inverse.h"

#include <stdlib.h>

#include "core/fit/fit.h"

#define CORE_REAL 64
#include "core/kernel.h"

enum {
  CELLS = 224, /* cells of the raster along each axis */
  MEDIA = 176, /* media of the mesh along each axis */
  CORNERS = 4, /* corners of a quad of the mesh */
  MARGIN = 1,  /* number of cells by which the image of what is not simple is enlarged */
};

/* The raster covers this range of ln(reading) below the largest reading of any medium. */
#define DEPTH 9.0

/* A determinant is taken as 0 if it is less than this, relative to the product of the gradients'
 * lengths. */
#define DETERMINANT_LEAST 1e-3

/* sqrt(CORE_FIT_AMBIGUOUS): the largest distance, in standard errors, between the readings and
 * those of a second medium. */
#define ERRORS 3.0
_Static_assert((int)ERRORS *(int)ERRORS >= (int)CORE_FIT_AMBIGUOUS,
               "the rectangle of readings that is searched holds every second solution");

struct fit_inverse {
  double first[2];              /* ln of the readings at the beginning of the raster */
  double per_cell[2];           /* number of cells per unit of ln(reading) */
  float start[CELLS][CELLS][2]; /* ln_ratio and ln_scattering of the medium of each cell's centre */
  /* The number of cells that are not simple among the first i and k cells of both axes, modulo
   * 2^16. */
  uint16_t knots[CELLS + 1][CELLS + 1];
};
_Static_assert(CELLS *CELLS < 1 << 16, "sums are known modulo 2^16");

/* A medium of the mesh: its readings' logarithms and their derivatives by ln_ratio and by
 * ln_scattering, in cells and steps of the mesh. */
struct node {
  double at[2];
  double slope[2][2];
  int sign; /* sign of the determinant; 0 if it is about 0 */
};

/* What is needed while the table is made. */
struct mesh {
  struct fit_place least;
  struct fit_place step;
  struct node node[MEDIA][MEDIA]; /* [step of ln_ratio][step of ln_scattering] */
  uint16_t media[CELLS][CELLS];   /* number of media found for each cell's centre */
  bool knot[CELLS][CELLS];
};

/* ---- the mesh -------------------------------------------------------------------------------- */

static int sign_of(const double slope[2][2]) {
  const double determinant = slope[0][0] * slope[1][1] - slope[0][1] * slope[1][0];
  const double squares = (slope[0][0] * slope[0][0] + slope[0][1] * slope[0][1]) *
                         (slope[1][0] * slope[1][0] + slope[1][1] * slope[1][1]);
  return determinant * determinant > DETERMINANT_LEAST * DETERMINANT_LEAST * squares
             ? (determinant > 0 ? 1 : -1)
             : 0;
}

/* Evaluates the model at all media, with logarithms in place of cells. Returns false if it does not
 * take one of them. */
static bool evaluate_mesh(struct mesh *mesh, const struct fit_model *model,
                          const struct fit_places *places, const double *weight) {
  for (size_t i = 0; i < MEDIA * MEDIA; i++) {
    struct node *node = &mesh->node[i / MEDIA][i % MEDIA];
    const struct fit_place place = {
        fma((double)(i / MEDIA), mesh->step.ln_ratio, mesh->least.ln_ratio),
        fma((double)(i % MEDIA), mesh->step.ln_scattering, mesh->least.ln_scattering)};
    double value[2], by_ratio[2], by_scattering[2];
    if (fit_values(model, place, places, value, by_ratio, by_scattering).field != NULL) {
      return false;
    }
    for (int k = 0; k < 2; k++) {
      const double per_value = 1 / real_max(value[k], 0x1p-1022);
      node->at[k] = fit_ln(value[k] * weight[k]);
      node->slope[k][0] = by_ratio[k] * per_value * mesh->step.ln_ratio;
      node->slope[k][1] = by_scattering[k] * per_value * mesh->step.ln_scattering;
    }
    node->sign = sign_of(node->slope);
  }
  return true;
}

/* Places the raster, and converts the mesh to its cells. */
static void lay_raster(struct mesh *mesh, fit_inverse *inverse) {
  for (int k = 0; k < 2; k++) {
    double least = 1e300, most = -1e300;
    for (size_t i = 0; i < MEDIA * MEDIA; i++) {
      const double at = mesh->node[i / MEDIA][i % MEDIA].at[k];
      least = real_min(least, at);
      most = real_max(most, at);
    }
    least = real_max(least, most - DEPTH);
    inverse->first[k] = least;
    inverse->per_cell[k] = CELLS / real_max(most - least, 1e-9);
    for (size_t i = 0; i < MEDIA * MEDIA; i++) {
      struct node *node = &mesh->node[i / MEDIA][i % MEDIA];
      node->at[k] = (node->at[k] - least) * inverse->per_cell[k];
      node->slope[k][0] *= inverse->per_cell[k];
      node->slope[k][1] *= inverse->per_cell[k];
    }
  }
}

/* ---- cells ----------------------------------------------------------------------------------- */

/* Returns the first cell whose centre is at x or more; 0 to CELLS. */
static size_t cell_from(double x) {
  return (size_t)real_min(real_max(x + 0.5, 0), CELLS);
}

/* A rectangle of cells: from `first` up to `end` - 1 along each axis. */
struct cells {
  size_t first[2];
  size_t end[2];
};

/* Returns the cells of the bounding rectangle of n points, widened by `more`. */
static struct cells cells_around(const struct node *const *nodes, size_t n, double more) {
  struct cells cells;
  for (int k = 0; k < 2; k++) {
    double least = nodes[0]->at[k], most = least;
    for (size_t i = 1; i < n; i++) {
      least = real_min(least, nodes[i]->at[k]);
      most = real_max(most, nodes[i]->at[k]);
    }
    cells.first[k] = cell_from(least - more - 0.5);
    cells.end[k] = cell_from(most + more + 0.5);
  }
  return cells;
}

static void mark(struct mesh *mesh, const struct node *const *nodes, size_t n) {
  const struct cells cells = cells_around(nodes, n, MARGIN);
  for (size_t i = cells.first[0]; i < cells.end[0]; i++) {
    for (size_t k = cells.first[1]; k < cells.end[1]; k++) {
      mesh->knot[i][k] = true;
    }
  }
}

/* ---- quads ----------------------------------------------------------------------------------- */

/* Returns the largest deviation, in cells, of an edge of the mesh from the straight line between
 * its ends. */
static double bend(const struct node *from, const struct node *to, int axis) {
  double most = 0;
  for (int k = 0; k < 2; k++) {
    const double straight = to->at[k] - from->at[k];
    const double off =
        real_max(fabs(from->slope[k][axis] - straight), fabs(to->slope[k][axis] - straight));
    most = real_max(most, 0.25 * off);
  }
  return most;
}

/* Returns twice the area of a triangle, with the sign of its orientation. */
static double area(const struct node *a, const struct node *b, const struct node *c) {
  return (b->at[0] - a->at[0]) * (c->at[1] - a->at[1]) -
         (b->at[1] - a->at[1]) * (c->at[0] - a->at[0]);
}

/* A quad of the mesh: corners in the order along ln_ratio, then along ln_scattering. */
struct quad {
  const struct node *corner[CORNERS];
};

static struct quad quad_at(const struct mesh *mesh, size_t i, size_t k) {
  return (struct quad){
      {&mesh->node[i][k], &mesh->node[i + 1][k], &mesh->node[i][k + 1], &mesh->node[i + 1][k + 1]}};
}

static bool is_simple(const struct quad *quad) {
  const struct node *const *c = quad->corner;
  const int sign = c[0]->sign;
  const double bent = real_max(real_max(bend(c[0], c[1], 0), bend(c[2], c[3], 0)),
                               real_max(bend(c[0], c[2], 1), bend(c[1], c[3], 1)));
  return sign != 0 && c[1]->sign == sign && c[2]->sign == sign && c[3]->sign == sign &&
         bent < MARGIN && sign * area(c[0], c[1], c[2]) > 0 && sign * area(c[3], c[2], c[1]) > 0;
}

/* Adds a triangle as the origin of the cells whose centres it holds. Its corners map to media at
 * these steps of the mesh. */
static void find_centres(struct mesh *mesh, fit_inverse *inverse, const struct node *const nodes[3],
                         const double steps[3][2]) {
  const struct cells cells = cells_around(nodes, 3, 1);
  const double per_area = 1 / area(nodes[0], nodes[1], nodes[2]);
  for (size_t i = cells.first[0]; i < cells.end[0]; i++) {
    for (size_t k = cells.first[1]; k < cells.end[1]; k++) {
      const struct node centre = {.at = {(double)i + 0.5, (double)k + 0.5}};
      const double second = area(nodes[0], &centre, nodes[2]) * per_area;
      const double third = area(nodes[0], nodes[1], &centre) * per_area;
      if (second >= 0 && third >= 0 && second + third <= 1) {
        double step[2];
        for (int axis = 0; axis < 2; axis++) {
          step[axis] = steps[0][axis] + second * (steps[1][axis] - steps[0][axis]) +
                       third * (steps[2][axis] - steps[0][axis]);
        }
        inverse->start[i][k][0] = (float)fma(step[0], mesh->step.ln_ratio, mesh->least.ln_ratio);
        inverse->start[i][k][1] =
            (float)fma(step[1], mesh->step.ln_scattering, mesh->least.ln_scattering);
        mesh->media[i][k]++;
      }
    }
  }
}

static void add_quad(struct mesh *mesh, fit_inverse *inverse, size_t i, size_t k) {
  const struct quad quad = quad_at(mesh, i, k);
  const struct node *const *c = quad.corner;
  if (!is_simple(&quad)) {
    mark(mesh, c, CORNERS);
    return;
  }
  const double r = (double)i, s = (double)k;
  const double near[3][2] = {{r, s}, {r + 1, s}, {r, s + 1}};
  const double far[3][2] = {{r + 1, s + 1}, {r, s + 1}, {r + 1, s}};
  find_centres(mesh, inverse, (const struct node *const[]){c[0], c[1], c[2]}, near);
  find_centres(mesh, inverse, (const struct node *const[]){c[3], c[2], c[1]}, far);
}

/* Marks the cells of media at the bounds of the search. */
static void mark_bounds(struct mesh *mesh) {
  for (size_t i = 0; i + 1 < MEDIA; i++) {
    for (size_t end = 0; end < MEDIA; end += MEDIA - 1) {
      mark(mesh, (const struct node *const[]){&mesh->node[i][end], &mesh->node[i + 1][end]}, 2);
      mark(mesh, (const struct node *const[]){&mesh->node[end][i], &mesh->node[end][i + 1]}, 2);
    }
  }
}

static void sum_knots(const struct mesh *mesh, fit_inverse *inverse) {
  for (size_t i = 0; i < CELLS; i++) {
    uint16_t row = 0;
    for (size_t k = 0; k < CELLS; k++) {
      row = (uint16_t)(row + (mesh->knot[i][k] || mesh->media[i][k] != 1));
      inverse->knots[i + 1][k + 1] = (uint16_t)(inverse->knots[i][k + 1] + row);
    }
  }
}

bool fit_inverse_create(fit_inverse **made, const struct fit_model *model,
                        const struct fit_places *places, const double *weight,
                        struct fit_place least, struct fit_place most) {
  fit_inverse *inverse = calloc(1, sizeof *inverse);
  struct mesh *mesh = calloc(1, sizeof *mesh);
  *made = inverse;
  if (inverse == NULL || mesh == NULL) {
    free(mesh);
    free(inverse);
    *made = NULL;
    return false;
  }
  mesh->least = least;
  mesh->step = (struct fit_place){(most.ln_ratio - least.ln_ratio) / (MEDIA - 1),
                                  (most.ln_scattering - least.ln_scattering) / (MEDIA - 1)};
  if (evaluate_mesh(mesh, model, places, weight)) {
    lay_raster(mesh, inverse);
    mark_bounds(mesh);
    for (size_t i = 0; i < (MEDIA - 1) * (MEDIA - 1); i++) {
      add_quad(mesh, inverse, i / (MEDIA - 1), i % (MEDIA - 1));
    }
  }
  sum_knots(mesh, inverse);
  free(mesh);
  return true;
}

size_t fit_inverse_bytes(const fit_inverse *inverse) {
  return inverse != NULL ? sizeof *inverse : 0;
}

/* ---- looking up ------------------------------------------------------------------------------ */

bool fit_inverse_start(const fit_inverse *inverse, const double *values, const double *errors,
                       struct fit_place *start) {
  size_t first[2], end[2], centre[2];
  for (int k = 0; k < 2; k++) {
    const double less = values[k] - ERRORS * errors[k], more = values[k] + ERRORS * errors[k];
    const double from = (fit_ln(less) - inverse->first[k]) * inverse->per_cell[k];
    const double to = (fit_ln(more) - inverse->first[k]) * inverse->per_cell[k];
    if (!(less > 0 && from >= 0 && to < CELLS)) {
      return false;
    }
    first[k] = (size_t)from;
    end[k] = (size_t)to + 1;
    const double at = (fit_ln(values[k]) - inverse->first[k]) * inverse->per_cell[k];
    centre[k] = (size_t)real_min(real_max(at, from), to);
  }
  const uint16_t knots =
      (uint16_t)(inverse->knots[end[0]][end[1]] - inverse->knots[first[0]][end[1]] -
                 inverse->knots[end[0]][first[1]] + inverse->knots[first[0]][first[1]]);
  const float *place = inverse->start[centre[0]][centre[1]];
  *start = (struct fit_place){(double)place[0], (double)place[1]};
  return knots == 0;
}

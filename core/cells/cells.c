#include "core/cells/cells.h"

enum { TERMS = CORE_CELLS_TERMS, STEPS = CORE_CELLS_STEPS };

const double core_cells_points[TERMS] = {0, 0.25, 0.75, 1};

/* lagrange[degree - 1][i][k]: the coefficient of t^k in Lagrange's polynomial of point i. */
static const double lagrange[3][TERMS][TERMS] = {
    {{1, -1}, {0, 1}},
    {{1, -3, 2}, {0, 4, -4}, {0, -1, 2}},
    {{1, -19.0 / 3, 32.0 / 3, -16.0 / 3},
     {0, 8, -56.0 / 3, 32.0 / 3},
     {0, -8.0 / 3, 40.0 / 3, -32.0 / 3},
     {0, 1, -16.0 / 3, 16.0 / 3}},
};

void core_cells_through(int degree, const double *y, size_t stride, double *c) {
  for (int k = 0; k < TERMS; k++) {
    c[k] = 0;
    for (int i = 0; i <= degree; i++) {
      c[k] += y[(size_t)i * stride] * lagrange[degree - 1][i][k];
    }
  }
}

void core_cells_fit_lines(const double *values, size_t cells, float *out) {
  for (size_t cell = 0; cell < cells; cell++) {
    double c[TERMS];
    core_cells_through(STEPS, &values[STEPS * cell], 1, c);
    for (int k = 0; k < TERMS; k++) {
      out[TERMS * cell + (size_t)k] = (float)c[k];
    }
  }
}

void core_cells_fit_patches(const double *values, size_t rows, size_t columns, float *out) {
  const size_t count = STEPS * columns + 1;
  for (size_t patch = 0; patch < rows * columns; patch++) {
    const double *corner = &values[STEPS * (patch / columns) * count + STEPS * (patch % columns)];
    double along[TERMS][TERMS]; /* along[i][k]: coefficient of t^k at point i of the rows */
    for (int i = 0; i < TERMS; i++) {
      core_cells_through(STEPS, &corner[(size_t)i * count], 1, along[i]);
    }
    for (int k = 0; k < TERMS; k++) {
      double c[TERMS];
      core_cells_through(STEPS, &along[0][k], TERMS, c);
      for (int i = 0; i < TERMS; i++) {
        out[CORE_CELLS_PATCH * patch + (size_t)(TERMS * i + k)] = (float)c[i];
      }
    }
  }
}

double core_cells_line(const float *c, double t) {
  return (double)c[0] + t * ((double)c[1] + t * ((double)c[2] + t * (double)c[3]));
}

double core_cells_patch(const float *c, double p, double t) {
  double sum = 0;
  for (int i = STEPS; i >= 0; i--) {
    sum = core_cells_line(&c[TERMS * i], t) + p * sum;
  }
  return sum;
}

bool core_cells_hold(uint32_t first, uint32_t cuts, uint32_t cuts_most, size_t cells) {
  return cuts <= cuts_most && first + ((size_t)1 << cuts) <= cells;
}

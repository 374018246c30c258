#include "core/solver/dense.h"

#include <math.h>

#include "core/kernels.h"

/* PANEL is a multiple of GROUP. */
enum { GROUP = 8, PANEL = 16 };

static size_t padded(size_t columns) {
  return (columns + GROUP - 1) / GROUP * GROUP;
}

size_t solver_dense_size(size_t rows, size_t columns) {
  return rows * padded(columns);
}

dense solver_dense_at(const core_isa *isa, double **memory, size_t rows, size_t columns,
                      bool is_complex) {
  const size_t size = solver_dense_size(rows, columns);
  const dense made = {
      isa, rows, columns, padded(columns), *memory, is_complex ? *memory + size : NULL};
  *memory += is_complex ? 2 * size : size;
  return made;
}

/* ---- instruction sets ----------------------------------------------------------------------- */

CORE_ISA_TABLE(dense_loops, solver_dense_loops)

/* ---- products ------------------------------------------------------------------------------- */

/* Returns a view of a rectangle of a matrix. */
static dense within(const dense *of, size_t row, size_t column, size_t rows, size_t columns) {
  const size_t skip = row * of->stride + column;
  return (dense){of->isa,    rows,          columns,
                 of->stride, of->re + skip, of->im == NULL ? NULL : of->im + skip};
}

/* Adds sign * a b to `to`. Rows of b and `to` are padded to a multiple of GROUP. */
static void add_dense(const dense *to, const dense *a, const dense *b, double sign) {
  const dense_loops *of = solver_dense_loops_of[to->isa->index];
  const dense_part to_part[2] = {{to->re, to->stride}, {to->im, to->stride}};
  const dense_part a_part[2] = {{a->re, a->stride}, {a->im, a->stride}};
  const dense_part b_part[2] = {{b->re, b->stride}, {b->im, b->stride}};
  of->add_product(to_part, a_part, b_part, to->rows, a->columns, padded(to->columns), sign);
}

void solver_dense_clear(const dense *of) {
  for (size_t i = 0; i < of->rows * of->stride; i++) {
    of->re[i] = 0;
    if (of->im != NULL) {
      of->im[i] = 0;
    }
  }
}

void solver_dense_combine(const dense *to, double x, const dense *a, double y, const dense *b) {
  const dense_loops *of = solver_dense_loops_of[to->isa->index];
  of->combine(to->re, x, a->re, y, b->re, to->rows * to->stride);
  if (to->im != NULL) {
    of->combine(to->im, x, a->im, y, b->im, to->rows * to->stride);
  }
}

void solver_dense_multiply(const dense *to, const dense *a, const dense *b) {
  solver_dense_clear(to);
  add_dense(to, a, b, 1);
}

/* ---- elimination ---------------------------------------------------------------------------- */

typedef struct number {
  double re, im;
} number;

static number number_at(const dense *of, size_t row, size_t column) {
  const size_t at = row * of->stride + column;
  return (number){of->re[at], of->im == NULL ? 0 : of->im[at]};
}

static void set_number(const dense *of, size_t row, size_t column, number to) {
  const size_t at = row * of->stride + column;
  of->re[at] = to.re;
  if (of->im != NULL) {
    of->im[at] = to.im;
  }
}

static number product(number a, number b) {
  return (number){a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}

/* Subtracts factor times row `from` from row `to`, in columns first to end - 1. */
static void subtract_row(const dense *of, size_t to, size_t from, number factor, size_t first,
                         size_t end) {
  const dense_loops *by = solver_dense_loops_of[of->isa->index];
  const size_t at = to * of->stride + first, other = from * of->stride + first;
  if (of->im == NULL) {
    by->subtract_real(of->re + at, of->re + other, factor.re, end - first);
  } else {
    by->subtract_complex(of->re + at, of->im + at, of->re + other, of->im + other, factor.re,
                         factor.im, end - first);
  }
}

static void swap_rows(const dense *of, size_t one, size_t other) {
  if (one == other) {
    return;
  }
  for (size_t i = 0; i < of->columns; i++) {
    const number kept = number_at(of, one, i);
    set_number(of, one, i, number_at(of, other, i));
    set_number(of, other, i, kept);
  }
}

/* Factors columns first to end - 1 by elimination with row exchanges (partial pivoting), which it
 * applies to b, too. Leaves the factors below the diagonal and the reciprocals of the pivots on it.
 * Returns false if a is singular. */
static bool factor_panel(const dense *a, const dense *b, size_t first, size_t end) {
  for (size_t column = first; column < end; column++) {
    size_t pivot = column;
    double largest = 0;
    for (size_t row = column; row < a->rows; row++) {
      const number here = number_at(a, row, column);
      const double size = here.re * here.re + here.im * here.im;
      if (size > largest) {
        largest = size;
        pivot = row;
      }
    }
    if (!(largest > 0) || !isfinite(largest)) {
      return false;
    }
    swap_rows(a, column, pivot);
    swap_rows(b, column, pivot);
    const number at = number_at(a, column, column);
    const number inverse = {at.re / largest, -at.im / largest};
    set_number(a, column, column, inverse);
    for (size_t row = column + 1; row < a->rows; row++) {
      const number factor = product(number_at(a, row, column), inverse);
      set_number(a, row, column, factor);
      subtract_row(a, row, column, factor, column + 1, end);
    }
  }
  return true;
}

/* Applies the factors of one panel, rows and columns first to end - 1 of a, to columns `column` and
 * beyond of `to`: to the panel's own rows, then to the rows below. */
static void apply_panel(const dense *a, const dense *to, size_t first, size_t end, size_t column) {
  if (column >= to->columns) {
    return;
  }
  for (size_t row = first + 1; row < end; row++) {
    for (size_t from = first; from < row; from++) {
      subtract_row(to, row, from, number_at(a, row, from), column, to->columns);
    }
  }
  if (end < a->rows) {
    const dense below = within(to, end, column, a->rows - end, to->columns - column);
    const dense factors = within(a, end, first, a->rows - end, end - first);
    const dense rows = within(to, first, column, end - first, to->columns - column);
    add_dense(&below, &factors, &rows, -1);
  }
}

static void scale_row(const dense *of, size_t row, number by) {
  for (size_t i = 0; i < of->columns; i++) {
    set_number(of, row, i, product(number_at(of, row, i), by));
  }
}

bool solver_dense_solve(const dense *a, const dense *b) {
  const size_t n = a->rows;
  for (size_t first = 0; first < n; first += PANEL) {
    const size_t end = first + PANEL < n ? first + PANEL : n;
    if (!factor_panel(a, b, first, end)) {
      return false;
    }
    apply_panel(a, a, first, end, end);
    apply_panel(a, b, first, end, 0);
  }
  for (size_t end = n; end > 0;) {
    const size_t first = (end - 1) / PANEL * PANEL;
    for (size_t row = end; row-- > first;) {
      for (size_t from = row + 1; from < end; from++) {
        subtract_row(b, row, from, number_at(a, row, from), 0, b->columns);
      }
      scale_row(b, row, number_at(a, row, row));
    }
    if (first > 0) {
      const dense above = within(b, 0, 0, first, b->columns);
      const dense factors = within(a, 0, first, first, end - first);
      const dense rows = within(b, first, 0, end - first, b->columns);
      add_dense(&above, &factors, &rows, -1);
    }
    end = first;
  }
  return true;
}

/* ---- symmetric matrices --------------------------------------------------------------------- */

/* Adds sign * a b to the upper triangle of the symmetric matrix `to`, from row `first` on: rectangles
 * of PANEL rows up to the last column. */
static void add_triangle(const dense *to, size_t first, const dense *a, const dense *b,
                         double sign) {
  for (size_t row = first; row < to->rows; row += PANEL) {
    const size_t rows = row + PANEL < to->rows ? PANEL : to->rows - row;
    const dense part = within(to, row, row, rows, to->columns - row);
    const dense left = within(a, row, 0, rows, a->columns);
    const dense right = within(b, 0, row, b->rows, b->columns - row);
    add_dense(&part, &left, &right, sign);
  }
}

void solver_dense_square(const dense *to, const dense *of) {
  solver_dense_clear(to);
  add_triangle(to, 0, of, of, 1);
}

void solver_dense_mirror(const dense *of) {
  for (size_t first = 0; first < of->rows; first += GROUP) {
    for (size_t row = first; row < of->rows; row++) {
      for (size_t column = first; column < first + GROUP && column < row; column++) {
        set_number(of, row, column, number_at(of, column, row));
      }
    }
  }
}

/* Factors rows first to end - 1 of a symmetric matrix without pivoting, and subtracts them from the
 * triangle below. Leaves the factors below the diagonal. Returns false if a pivot is 0. */
static bool factor_symmetric(const dense *a, size_t first, size_t end) {
  for (size_t row = first; row < end; row++) {
    const number at = number_at(a, row, row);
    const double size = at.re * at.re + at.im * at.im;
    if (!(size > 0) || !isfinite(size)) {
      return false;
    }
    const number inverse = {at.re / size, -at.im / size};
    set_number(a, row, row, inverse);
    for (size_t below = row + 1; below < a->rows; below++) {
      const number factor = product(number_at(a, row, below), inverse);
      set_number(a, below, row, factor);
      if (below < end) {
        subtract_row(a, below, row, factor, below, a->columns);
      }
    }
  }
  const dense factors = within(a, 0, first, a->rows, end - first);
  const dense rows = within(a, first, 0, end - first, a->columns);
  add_triangle(a, end, &factors, &rows, -1);
  return true;
}

bool solver_dense_congruence(const dense *to, const dense *a, const dense *b, const dense *spare) {
  const size_t n = a->rows;
  for (size_t first = 0; first < n; first += PANEL) {
    const size_t end = first + PANEL < n ? first + PANEL : n;
    if (!factor_symmetric(a, first, end)) {
      return false;
    }
    apply_panel(a, b, first, end, 0);
  }
  const dense left = within(spare, 0, 0, n, n);
  for (size_t first = 0; first < n; first += GROUP) {
    for (size_t column = 0; column < n; column++) {
      for (size_t row = first; row < first + GROUP && row < n; row++) {
        set_number(&left, column, row, product(number_at(b, row, column), number_at(a, row, row)));
      }
    }
  }
  solver_dense_clear(to);
  add_triangle(to, 0, &left, b, 1);
  solver_dense_mirror(to);
  return true;
}

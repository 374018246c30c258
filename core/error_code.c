#include "core/error_code.h"

#include <math.h>

#define LEAST 1e-4
#define STEP 1.04

/* 1.04^code by repeated squaring. */
double core_error_of_code(unsigned code) {
  double error = LEAST, square = STEP;
  for (unsigned bits = code; bits > 0; bits >>= 1) {
    error = (bits & 1) != 0 ? error * square : error;
    square *= square;
  }
  return code < CORE_ERROR_CODE_ANY ? error : (double)INFINITY;
}

unsigned core_error_code(double error) {
  unsigned code = 0;
  while (code < CORE_ERROR_CODE_ANY && !(error <= core_error_of_code(code))) {
    code++;
  }
  return code;
}

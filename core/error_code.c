#include "core/error_code.h"

#include <math.h>

#define LEAST 1e-4
#define STEP 1.04

double core_error_of_code(unsigned code) {
  double error = LEAST;
  for (unsigned i = 0; i < code; i++) {
    error *= STEP;
  }
  return code < CORE_ERROR_CODE_ANY ? error : (double)INFINITY;
}

unsigned core_error_code(double error) {
  unsigned code = 0;
  for (double step = LEAST; code < CORE_ERROR_CODE_ANY && !(error <= step); step *= STEP) {
    code++;
  }
  return code;
}

/* error_code: errors as bytes, as core/tradeoff.def holds them. Code c is an error of at most
 * 1e-4 times 1.04^c; 255: it may be any. */
#ifndef DIPOLED_CORE_ERROR_CODE_H
#define DIPOLED_CORE_ERROR_CODE_H

#define CORE_ERROR_CODE_ANY 255u

/* The least code whose error is at least this one, which is 0 or more. */
unsigned core_error_code(double error);

/* The error of a code up to 255 (infinity), with the same bits on every machine. */
double core_error_of_code(unsigned code);

#endif

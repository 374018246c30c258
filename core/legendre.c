#include "core/legendre.h"

#include <pthread.h>
#include <string.h>

enum { TERMS = CORE_LEGENDRE_TERMS };

/* share[i][k]: the weight of the value at node i in the coefficient of P_k */
static double share[TERMS][TERMS];
static pthread_once_t shares_once = PTHREAD_ONCE_INIT;

static void set_shares(void) {
  for (int i = 0; i < TERMS; i++) {
    const double s = 2 * core_gauss_node(i) - 1;
    double p = 1, before = 0;
    for (int k = 0; k < TERMS; k++) {
      share[i][k] = (2 * k + 1) * core_gauss_weight(i) * p;
      const double next = ((2 * k + 1) * s * p - k * before) / (k + 1);
      before = p;
      p = next;
    }
  }
}

void core_legendre_fit(const double value[TERMS], double series[TERMS]) {
  pthread_once(&shares_once, set_shares);
  memset(series, 0, TERMS * sizeof *series);
  for (int i = 0; i < TERMS; i++) {
    for (int k = 0; k < TERMS; k++) {
      series[k] += share[i][k] * value[i];
    }
  }
}

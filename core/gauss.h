/* gauss: holds the positive nodes of the Gauss-Legendre rule with 16 points on [-1, 1], and their
 * weights. The rule is symmetric. The nodes, roots of the Legendre polynomial, were computed with
 * 40 digits. */
#ifndef DIPOLED_CORE_GAUSS_H
#define DIPOLED_CORE_GAUSS_H

enum { CORE_GAUSS_HALF = 8 };

static const double core_gauss[CORE_GAUSS_HALF][2] = {
    {0.095012509837637440185, 0.18945061045506849629},
    {0.28160355077925891323, 0.18260341504492358887},
    {0.45801677765722738634, 0.16915651939500253819},
    {0.61787624440264374845, 0.14959598881657673208},
    {0.7554044083550030339, 0.12462897125553387205},
    {0.86563120238783174388, 0.09515851168249278481},
    {0.94457502307323257608, 0.062253523938647892863},
    {0.9894009349916499326, 0.027152459411754094852},
};

/* These return node i of the rule mapped to [0, 1], and its weight; i is 0 to 2 CORE_GAUSS_HALF -
 * 1. */
static inline double core_gauss_node(int i) {
  const double x = core_gauss[i / 2][0];
  return 0.5 + (i % 2 ? 0.5 * x : -0.5 * x);
}

static inline double core_gauss_weight(int i) {
  return 0.5 * core_gauss[i / 2][1];
}

#endif

/* gather: the light that leaves a surface at a point x,
 *
 *   M_c(x) = sum over points i of R_c(|x - x_i|) P_i,c
 *
 * where the points x_i hold the power P_i,c that enters there, in each of up to eight channels
 * (irradiance times area; Jensen and Buhler 2002, section 3). An octree over the points lets one
 * node stand for many of them, where a bound on what this changes allows it:
 * core/gather/loops.h derives the bound.
 *
 * A caller builds the points once (core_gather_points), prepares profiles and a tolerance
 * (core_gather_sum), and gathers at as many queries as it likes. A query's values depend on the
 * points, the profiles, the tolerance and the query alone: they have the same bits on every
 * instruction set, whatever queries come before and beside it and however they are cut into calls.
 *
 * Lengths are in mm, powers in W, M in W/mm^2.
 */
#ifndef DIPOLED_CORE_GATHER_GATHER_H
#define DIPOLED_CORE_GATHER_GATHER_H

#include "core/model_error.h"

enum { CORE_GATHER_CHANNELS_MAX = 8 };
#define CORE_GATHER_POINTS_MAX ((size_t)1 << 24)

/* Coordinates of points and queries are from -CORE_GATHER_MOST_MM to CORE_GATHER_MOST_MM, and
 * powers from 0 to CORE_GATHER_MOST_POWER. */
#define CORE_GATHER_MOST_MM 1e9
#define CORE_GATHER_MOST_POWER 1e30

/* The least tolerance above 0, and the largest. */
#define CORE_GATHER_TOLERANCE_MIN 1e-9
#define CORE_GATHER_TOLERANCE_MAX 0.5

/* ---- points ---------------------------------------------------------------------------------- */

/* Return the first fault, in the order of the arrays: a coordinate (field `points` or `queries`) or
 * a power (field `power`) that is not finite or outside of its range. The index is that of the
 * point or query, not of the number. They may be called for each part of the points by itself; the
 * index then counts from the part's start. xyz[3 n]: x, y and z of each point; power[channels n]:
 * of each point, its channels. */
core_fault core_gather_check_points(size_t n, const double *xyz, size_t channels,
                                    const float *power);
core_fault core_gather_check_queries(size_t n, const double *xyz);

/* Points with their tree. Immutable once they are built: any number of threads may use them. */
typedef struct core_gather_points core_gather_points;

/* Begins to build points that core_gather_check_points() accepts; 1 to CORE_GATHER_POINTS_MAX points
 * and 1 to CORE_GATHER_CHANNELS_MAX channels (asserted). The arrays stay the caller's and must not
 * change until the points are built; they are not used after that. Returns NULL if memory runs out.
 * The caller frees the points with core_gather_points_free(), which accepts NULL. */
core_gather_points *core_gather_points_create(size_t n, const double *xyz, size_t channels,
                                              const float *power);
void core_gather_points_free(core_gather_points *points);

/* Builds on, for about this many nanoseconds' worth of work on one core. Returns true once the
 * points are built. The result does not depend on how the work is cut. */
bool core_gather_points_build(core_gather_points *points, uint64_t work_ns);

/* For points that are built: their channels, and the bytes that they take. */
size_t core_gather_points_channels(const core_gather_points *points);
size_t core_gather_points_bytes(const core_gather_points *points);

/* ---- sums ------------------------------------------------------------------------------------ */

/* Profiles, one for each channel, with bounds on how they vary with distance. Immutable. */
typedef struct core_gather_sum core_gather_sum;

/* Prepares a sum. profiles[channels] have one evaluator (asserted); they stay the caller's and must
 * live as long as the sum. tolerance: the largest error of M through nodes that stand for points,
 * relative to M, for each query and channel; CORE_GATHER_TOLERANCE_MIN to _MAX, or 0 for the sum of
 * all points, in the order of the tree and in double precision. Takes half a millisecond for each
 * channel, and evaluates R at 928 distances unless the evaluator is lut, whose tables hold these
 * values; if the tolerance is 0, it does neither.
 * On a fault *sum is NULL; otherwise the caller frees it with core_gather_sum_free(), which accepts
 * NULL. Faults: `tolerance`, and `memory`. */
core_fault core_gather_sum_prepare(core_gather_sum **sum, const core_isa *isa, size_t channels,
                                   const core_profile *const *profiles, double tolerance);
void core_gather_sum_free(core_gather_sum *sum);

/* Returns about how long gathering takes, in evaluations of one quantity of a dipole: at n queries, 1
 * or more, in an order as of core_gather(), of which those in one cell share the work of finding its
 * nodes. The costs are those measured for points on a surface. */
double core_gather_cost(const core_gather_sum *sum, const core_gather_points *points, size_t n,
                        const uint32_t *order, const double *xyz);

/* ---- gathering ------------------------------------------------------------------------------- */

/* What was visited; calls add to it. Before the first one it is all 0. */
typedef struct core_gather_visits {
  uint64_t queries; /* whose sums are known */
  uint64_t nodes;   /* nodes that stood for their points */
  uint64_t points;  /* points that were summed one by one */
  uint64_t tested;  /* nodes whose bound was computed */
  /* Unless there are no queries, a lower bound of the distance from any of them to a point with power
   * (INFINITY if there is none), and the least sum, for each channel: */
  double nearest_mm[CORE_GATHER_CHANNELS_MAX];
  double dimmest[CORE_GATHER_CHANNELS_MAX]; /* W/mm^2 */
  double farthest_mm;                       /* no point is farther from any query */
} core_gather_visits;

/* Working memory of one thread, some ten megabytes. */
typedef struct core_gather_scratch core_gather_scratch;

/* For points that are built. Returns NULL if memory runs out. The scratch may be used with this sum
 * and these points alone, and they must live as long as it is used: a call continues in the cell
 * where the one before ended. The caller frees it with core_gather_scratch_free(), which accepts
 * NULL. */
core_gather_scratch *core_gather_scratch_create(const core_gather_sum *sum,
                                                const core_gather_points *points);
void core_gather_scratch_free(core_gather_scratch *scratch);
size_t core_gather_scratch_bytes(void);

/* Sets order[n] to an order of queries that core_gather_check_queries() accepts in which neighbours
 * follow each other: that of the points' tree, or of the cube around the queries if points is NULL. Queries that are gathered in this order take a fraction of the time, because
 * those in one cell share a list of nodes; their values are the same in any order. */
void core_gather_order(const core_gather_points *points, size_t n, const double *xyz,
                       uint32_t *order);

/* Gathers at the n queries order[0], order[1], ..., or 0, 1, ... n - 1 if order is NULL. The queries
 * have passed core_gather_check_queries(); xyz[3 ...] holds the coordinates of query q from 3 q on,
 * and M[channels ...] gets its values from channels q on. bound, NULL or like M, gets the largest
 * relative error that nodes in place of points may have caused, which is at most the tolerance; the
 * profile's own error comes on top (core_gather_error()). Where R is infinite, as models that rise
 * like 1 / r are at the point itself, M is infinite and its bound is 0. Points without power do not
 * count. With the evaluators f32 and lut, what a profile loses by underflow (16 of the smallest
 * subnormal numbers for each W) is lost here. The sum and the points are those of the scratch, and
 * have the same number of channels (asserted). */
void core_gather(const core_gather_sum *sum, const core_gather_points *points,
                 core_gather_scratch *scratch, size_t n, const uint32_t *order, const double *xyz,
                 double *M, float *bound, core_gather_visits *visits);

/* Does a part of core_gather(): continues where the call before stopped, and stops when *work, in
 * evaluations of one quantity of a dipole, is used up. Returns how many of the n queries are done,
 * the first ones; the next call gets the queries behind them, with the same M and bound. It reduces
 * *work by what was done, which ends below 0 by at most one block of 512 points, or by the making of
 * one list: for eight channels and the smallest tolerances some ten milliseconds' worth. The values
 * have the same bits wherever calls stop. */
size_t core_gather_on(const core_gather_sum *sum, const core_gather_points *points,
                      core_gather_scratch *scratch, size_t n, const uint32_t *order,
                      const double *xyz, double *M, float *bound, core_gather_visits *visits,
                      double *work);

/* The relative error of M that comes from the profile of a channel itself and from rounding: M is
 * within bound + core_gather_error() of the sum over the model's exact formula, at each query of these
 * visits. The nearest point, the farthest and the dimmest sum count. 0 without queries or light. */
double core_gather_error(const core_gather_sum *sum, const core_gather_points *points,
                         size_t channel, const core_gather_visits *visits);

/* The model's error that is stated for a channel with these errors: that of R at 0.01 to 20 mean free
 * paths. NAN: it is not known. */
double core_gather_model_error(const core_model_errors *errors, const core_medium *medium);

#endif

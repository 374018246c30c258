/* backlog: what the jobs of a worker have still to do, in radii of a dipole, and who is turned away
 * when that is too much. On the worker's thread. */
#ifndef DIPOLED_BACKLOG_H
#define DIPOLED_BACKLOG_H

#include "proto/wire.h"
#include "server/options.h"

/* Of one worker; starts all 0. */
struct backlog {
  uint64_t owed_radii; /* that jobs under way have still to evaluate, once for each array */
};

/* One job's share of it. */
struct backlog_share {
  uint64_t owed_radii;
  bool rests; /* it does not hold it at the moment */
};

/* BUSY, with `field`, for a large job while the worker has more to do than max_backlog_ms; small
 * ones are always taken: they take turns with the large ones. Otherwise what the job owes is noted;
 * radii: of any size. */
wire_error backlog_admit(struct backlog *backlog, struct backlog_share *share,
                         const struct options *options, double radii, const char *field);

/* So many have been evaluated. */
void backlog_pay(struct backlog *backlog, struct backlog_share *share, uint64_t radii);

/* The job owes nothing any more. */
void backlog_forgive(struct backlog *backlog, struct backlog_share *share);

/* Between parts, while the reader does not keep up: what is not being worked on keeps nobody else
 * from being admitted; and when it goes on. */
void backlog_rest(struct backlog *backlog, struct backlog_share *share);
void backlog_resume(struct backlog *backlog, struct backlog_share *share);

#endif

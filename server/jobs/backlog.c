#include "server/jobs/backlog.h"

#include "server/jobs/job_state.h"

/* About what a radius takes, ns: of a dipole on a slow machine. */
#define RADIUS_NS 2

/* More than any sum of shares that are counted exactly could do harm with. */
#define SHARE_MOST 1e15

wire_error backlog_admit(struct backlog *backlog, struct backlog_share *share,
                         const struct options *options, double radii, const char *field) {
  const uint64_t backlog_ms = backlog->owed_radii * RADIUS_NS / 1000000;
  share->owed_radii = (uint64_t)(radii < SHARE_MOST ? radii : SHARE_MOST);
  share->rests = false;
  if (share->owed_radii > JOB_SLICE_RADII && backlog_ms >= options->max_backlog_ms) {
    share->owed_radii = 0;
    wire_error error =
        wire_error_make(WIRE_STATUS_BUSY, field, "fewer, or later: max_backlog_ms is to do");
    error.retry_after_ms = backlog_ms < 60000 ? (uint32_t)backlog_ms : 60000;
    return error;
  }
  backlog->owed_radii += share->owed_radii;
  return wire_error_none();
}

void backlog_pay(struct backlog *backlog, struct backlog_share *share, uint64_t radii) {
  const uint64_t paid = radii < share->owed_radii ? radii : share->owed_radii;
  share->owed_radii -= paid;
  backlog->owed_radii -= share->rests ? 0 : paid;
}

void backlog_forgive(struct backlog *backlog, struct backlog_share *share) {
  backlog_pay(backlog, share, share->owed_radii);
}

void backlog_rest(struct backlog *backlog, struct backlog_share *share) {
  backlog->owed_radii -= share->rests ? 0 : share->owed_radii;
  share->rests = true;
}

void backlog_resume(struct backlog *backlog, struct backlog_share *share) {
  backlog->owed_radii += share->rests ? share->owed_radii : 0;
  share->rests = false;
}

/* repeat: a short request that is the one before it but for its radii, as farms send them by the
 * million: it is answered from what is known of that one, with the same bytes as otherwise.
 *
 * What counts as the same is the payload before the radii, byte for byte.
 */
#ifndef DIPOLED_REPEAT_H
#define DIPOLED_REPEAT_H

#include "server/job.h"

/* Keeps a job's request and the start of its reply in mind, with its profile, if it is one that may
 * be repeated; called when the reply is complete. True: it does, and the job keeps its profile. */
bool repeat_learn(struct job *job);

/* Lets go of all that. */
void repeat_forget(struct job *job);

/* Whether a request is a repetition, with nothing wrong. Its reply takes job->layout.payload_bytes. */
bool repeat_matches(const struct job *job, const uint8_t *payload, size_t payload_bytes);

/* Fills in the reply; the values are there after batch_finish(). */
void repeat_answer(struct job *job, struct server *server, struct job_scratch *scratch,
                   const uint8_t *payload, uint8_t *reply);

#endif

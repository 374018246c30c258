/* request: sends requests, receives replies, and repeats requests that failed. It does not know the
 * messages: a libdipole_kind says how the replies to one kind of request are read.
 *
 * A call begins and sends a request. The request stays in client->pending until its reply is
 * complete, and then goes to the call that waits for it. If retries are on, the client keeps a copy
 * of the request meanwhile. It sends the copy over a new connection when the old one is lost, or
 * over the same one when the daemon was busy. A new connection brings no replies of the old one,
 * and the parts of an unfinished reply are thrown away, so no reply comes twice. */
#ifndef LIBDIPOLE_REQUEST_H
#define LIBDIPOLE_REQUEST_H

#include <sys/types.h>

#include "clients/c/address.h"
#include "clients/c/parts.h"
#include "clients/c/stream.h"

/* ---- a client ----------------------------------------------------------------------------------- */

/* How a client retries: connects again, and sends requests again. */
typedef struct libdipole_retry {
  unsigned for_ms;    /* for how long the client retries; 0 means never */
  unsigned pause_ms;  /* the next pause while there is no connection; else 0 */
  size_t kept_bytes;  /* size of the copies of all requests */
  size_t later_count; /* how many requests wait to be sent again */
  uint64_t random;    /* see libdipole_random() */
} libdipole_retry;

struct dipole_client {
  libdipole_stream stream;
  /* the process that opened the client; in a forked process the client can only be closed */
  pid_t process;
  pid_t daemon; /* a private daemon, or 0 */
  unsigned connect_timeout_ms, timeout_ms, call_timeout_ms, in_flight_max;
  int64_t until_ms;   /* end of the running call's time, in ms of libdipole_now_ms(); 0: no limit */
  unsigned waited_ms; /* ms for which earlier calls that ran out of time received no byte */
  dipole_error lost;  /* why there is no connection; kind NONE if there is one */
  dipole_error broken; /* why the client can never connect again; kind NONE if it can */
  bool torn;           /* true while bytes move, a request is made, or a caller's function runs */
  libdipole_addresses addresses;
  libdipole_retry retry;

  /* Tries each address once, until until_ms, and opens a client at the first that works. Returns
   * NULL if none works: *may_pass says whether trying again may help, and *error why it failed. */
  dipole_client *(*reopen)(dipole_client *client, int64_t until_ms, bool *may_pass,
                           dipole_error *error);

  /* The outstanding requests are pending[pending_begin ... pending_begin + pending_count - 1], in
   * the order of their ids. */
  uint64_t last_id;
  libdipole_pending *pending;
  size_t pending_begin, pending_count, pending_capacity;
  size_t arrived_count;   /* number of pending requests that have a reply */
  size_t dropped_count;   /* number of pending requests that the caller has dropped */
  size_t held_count;      /* number of requests begun since bytes were last sent */
  libdipole_frame *frame; /* the frame that is being received; NULL: a header comes next */

  dipole_info *info; /* one block of memory; NULL before the reply to hello */
};

/* ---- one request --------------------------------------------------------------------------- */

/* Begins a call: its time limit counts from now. */
void libdipole_call_begin(dipole_client *client, const libdipole_kind *kind);

/* Begins a request and sets pending->id. *payload is memory of payload_bytes, which the caller
 * fills before it calls libdipole_request_send(). */
bool libdipole_request_begin(dipole_client *client, libdipole_pending *pending,
                             uint64_t payload_bytes, uint8_t **payload, dipole_error *error);

/* Sends the request that was begun last. Waits only if too many bytes are unsent. */
bool libdipole_request_send(dipole_client *client, dipole_error *error);

/* Waits for the reply to request id, or to any request if id is 0, and moves the request to
 * *pending. The caller frees pending->frame, which may be an error frame. If the frame is a report
 * of progress, the request continues. reader: that of the request, or NULL; if it has stopped before
 * the last part, pending->frame is NULL. */
bool libdipole_request_wait(dipole_client *client, uint64_t id, const libdipole_reader *reader,
                            libdipole_pending *pending, dipole_error *error);

/* Waits for the reply to request pending->id. Returns the frame, which the caller frees. Returns
 * NULL if the request failed or was refused. */
libdipole_frame *libdipole_reply(dipole_client *client, libdipole_pending *pending,
                                 dipole_error *error);

/* Sends a request with this payload and waits for its reply like libdipole_reply(). */
libdipole_frame *libdipole_call(dipole_client *client, libdipole_pending *pending,
                                const uint8_t *payload, size_t payload_bytes, dipole_error *error);

/* Sends a cancel request for a Monte Carlo job or a gather, which is never sent again. Sets *cancel_id
 * to the id of the cancel request, whose reply is to be taken or dropped. */
bool libdipole_cancel(dipole_client *client, uint64_t job_id, uint64_t *cancel_id,
                      dipole_error *error);

/* Gives up a request. If its reply is still to come, the client throws it away on arrival. */
void libdipole_request_drop(dipole_client *client, uint64_t id);

/* Returns true unless the frame is an error frame. If it is, sets *error and returns false. */
bool libdipole_refusal_check(const dipole_client *client, const libdipole_pending *pending,
                             dipole_error *error);

/* ---- for kinds of replies ------------------------------------------------------------------ */

/* Fails with kind PROTOCOL, after which the client can only be closed. Returns false. */
bool libdipole_bad_reply(dipole_client *client, const char *what, dipole_error *error);

/* Frees all requests and the frame that is being received. */
void libdipole_requests_free(dipole_client *client);

/* ---- for connecting ------------------------------------------------------------------------ */

/* Sends hello and makes client->info of the reply and a copy of the connection's address. */
bool libdipole_hello(dipole_client *client, const char *address, dipole_error *error);

/* Returns whether connecting again may help after this error. */
bool libdipole_is_temporary(const dipole_error *error);

#endif

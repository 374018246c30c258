/* request: sends requests, receives answers, and repeats requests that failed. It does not know the
 * messages: a libdipole_kind says how the answers to one kind of request are read.
 *
 * A call begins and sends a request. The request stays in client->pending until its answer is
 * complete, and then goes to the call that waits for it. If retries are on, the client keeps a copy
 * of the request meanwhile. It sends the copy over a new connection when the old one is lost, or
 * over the same one when the daemon was busy. A new connection brings no answers of the old one,
 * and the parts of an unfinished answer are thrown away, so no answer comes twice. */
#ifndef LIBDIPOLE_REQUEST_H
#define LIBDIPOLE_REQUEST_H

#include <sys/types.h>

#include "clients/c/address.h"
#include "clients/c/stream.h"
#include "proto/schema.h"
#include "proto/wire.h"

/* ---- what is asked and answered ------------------------------------------------------------ */

/* A received frame, or an answer that was put together of several frames. The caller's result is the
 * first member, so that freeing it frees the payload, too. Behind the payload there is room for the
 * channels of an eval. If the arrays go into the caller's memory, the payload holds
 * only the head: the fixed part and the channels. */
typedef struct libdipole_frame {
  union {
    dipole_result result;
    dipole_inversion inversion;
    dipole_fits fits;
    dipole_varying_result varying;
  };
  wire_header header;
  uint64_t payload_bytes; /* may be more than a header can say if the answer had several parts */
  uint64_t stored_bytes;  /* the number of bytes in payload: all of them, or only the head */
  void *into_values;      /* the caller's memory for the values; NULL if there is none */
  void *into_radii;
  _Alignas(8) uint8_t payload[];
} libdipole_frame;

/* The caller's function that gets each part of an answer when it arrives. */
typedef struct libdipole_reader {
  bool (*part)(void *context, const dipole_result *part, uint64_t radius_first);
  void *context;
  bool stopped; /* The function returned false. */
} libdipole_reader;

typedef struct libdipole_pending libdipole_pending;

/* How the answers to one kind of request are read. A function may be NULL. */
typedef struct libdipole_kind {
  /* Every daemon gives the same answer to such a request, so the client may send it again. */
  bool repeatable;
  /* The time limit of calls does not apply to this kind of request. */
  bool endless;
  /* Of an answer in parts: what follows the structure of its reply; NULL: the answer is one frame.
   * See clients/c/parts.h. */
  const schema_payload *reply;
  /* Returns whether a part answers the request, and belongs to `whole`: what has been merged from
   * the parts before it, or NULL. Both are structures of the reply. Merges the part. */
  bool (*merge)(const libdipole_pending *pending, const void *part, void *whole);
  /* Whoever takes an answer in one part checks it. */
  bool checked_later;
  /* Gives a part to pending->reader. */
  void (*hand_on)(libdipole_pending *pending, libdipole_frame *part);
  /* Returns whether this frame only reports progress, so that more frames follow. */
  bool (*is_progress)(const libdipole_frame *frame);
  /* Returns whether a daemon that stopped has cut this answer off, so that the client asks again. */
  bool (*is_cut_off)(const libdipole_frame *frame);
  /* Called when the stream's target is full: sets the target for the next bytes of the frame. *more
   * is false if the frame is complete. NULL: the whole payload is stored in the frame. */
  bool (*place)(dipole_client *client, libdipole_pending *pending, bool *more, dipole_error *error);
  /* Called when the request is dropped: keeps the rest of the frame out of the caller's memory. */
  void (*discard)(dipole_client *client, libdipole_pending *pending);
} libdipole_kind;

/* A repeatable request whose answer is one frame. */
extern const libdipole_kind libdipole_plain;

/* A request whose answer has not been handed out. The function that begins the request sets the
 * first group of fields, which say what the answer may look like. */
struct libdipole_pending {
  const libdipole_kind *kind;
  uint16_t type; /* enum wire_type */
  uint32_t deadline_ms;
  uint64_t reply_bytes_min, reply_bytes_max; /* limits for the payload of each frame */
  unsigned model;                            /* of an eval or sample; may be DIPOLE_ANY_MODEL */
  uint16_t evaluator, wanted;                /* of an eval or sample */
  uint16_t moments;                          /* of a varying */
  uint32_t medium_count; /* 0 if the request lists no media; for a fit: residuals of each set */
  uint64_t radius_count; /* of an eval or sample; for an invert: its media; for a fit: its sets */
  libdipole_reader *reader; /* gets each part when it arrives; NULL: the parts are put together */
  void *into_values;        /* see dipole_query */
  void *into_radii;

  uint64_t id;
  libdipole_frame *frame; /* the answer; NULL if it is not complete yet */
  uint32_t next_part;     /* the number of the next part of the answer */
  uint32_t part_count;    /* the number of parts, as the first one that was gathered says */
  uint64_t next_radius;   /* the position of the first radius, medium or set of the next part */
  /* The parts so far, as one answer. If there is a reader, this frame has no arrays. */
  libdipole_frame *gathered;
  bool dropped; /* The caller has dropped the request: do not use reader and into_*. */

  size_t frame_bytes;
  uint8_t *kept;     /* [frame_bytes] copy of the request; NULL: it cannot be sent again */
  int64_t sent_ms;   /* when the request was first sent, if it has a deadline */
  int64_t failed_ms; /* when the request first failed; 0 if it has not */
  int64_t again_ms;  /* when to send the request again; 0 if it has been sent */
};

/* State of receiving the arrays of a frame into the caller's memory. */
typedef struct libdipole_into {
  bool begun;            /* whether the head has arrived and is valid */
  wire_eval_reply fixed; /* the start of the head */
  uint64_t array_count;  /* number of arrays in the frame, radii included */
  uint64_t array_bytes;  /* size of each array, padding included */
  uint64_t array;        /* position of the array that is being received */
  uint64_t done_bytes;   /* number of bytes of this array that have been given a place */
  uint8_t discarded[16384];
} libdipole_into;

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
  pid_t process; /* the one that opened the client; a forked one may only close it */
  pid_t daemon;  /* a private daemon, or 0 */
  unsigned connect_timeout_ms, timeout_ms, call_timeout_ms, in_flight_max;
  int64_t until_ms;    /* when the running call has to end; 0 means never */
  unsigned waited_ms;  /* how long earlier calls, whose time ended, saw no byte of the daemon */
  dipole_error lost;   /* why there is no connection; kind NONE if there is one */
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
  size_t arrived_count;   /* number of pending requests that have an answer */
  size_t dropped_count;   /* number of pending requests that the caller has dropped */
  size_t held_count;      /* number of requests begun since bytes were last sent */
  libdipole_frame *frame; /* the frame that is being received; NULL: a header comes next */
  libdipole_into into;

  dipole_info *info; /* one block; NULL before the reply to hello */
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

/* Waits for the answer to request id, or to any request if id is 0, and moves the request to
 * *pending. The caller frees pending->frame, which may be an error frame. If the frame is a report
 * of progress, the request goes on. */
bool libdipole_request_wait(dipole_client *client, uint64_t id, libdipole_pending *pending,
                            dipole_error *error);

/* Waits until a request's reader has got all parts of the answer, the reader has stopped, or an
 * error frame has ended the answer. The caller frees pending->frame, which is NULL if the reader
 * stopped before the last part. */
bool libdipole_request_read(dipole_client *client, uint64_t id, const libdipole_reader *reader,
                            libdipole_pending *pending, dipole_error *error);

/* Waits for the answer to request pending->id. Returns the frame, which the caller frees. Returns
 * NULL if the request failed or was refused. */
libdipole_frame *libdipole_reply(dipole_client *client, libdipole_pending *pending,
                                 dipole_error *error);

/* Sends a request with this payload and waits for its answer like libdipole_reply(). */
libdipole_frame *libdipole_ask(dipole_client *client, libdipole_pending *pending,
                               const uint8_t *payload, size_t payload_bytes, dipole_error *error);

/* Lets a request that has been sent never be sent again. */
void libdipole_request_once(dipole_client *client, uint64_t id);

/* Sends a cancel request for a Monte Carlo job or a gather, which is never sent again. Sets *cancel_id
 * to the id of the cancel request, whose answer is to be taken or dropped. */
bool libdipole_cancel(dipole_client *client, uint64_t job_id, uint64_t *cancel_id,
                      dipole_error *error);

/* Gives up a request. If its answer is still to come, the client throws it away on arrival. */
void libdipole_request_drop(dipole_client *client, uint64_t id);

/* Returns true if the answer is a reply. If it is an error frame, sets *error and returns false. */
bool libdipole_refusal_check(const dipole_client *client, const libdipole_pending *pending,
                             dipole_error *error);

/* ---- for kinds of answers ------------------------------------------------------------------ */

/* Allocates a frame with this header, with room for stored_bytes of payload and for channel_count
 * channels. payload_bytes: the size of the payload in the answer. Returns NULL if there is no
 * memory. */
libdipole_frame *libdipole_frame_new(const wire_header *header, uint64_t payload_bytes,
                                     uint64_t stored_bytes, uint32_t channel_count,
                                     dipole_error *error);

/* Fails with kind PROTOCOL, after which the client can only be closed. Returns false. */
bool libdipole_bad_answer(dipole_client *client, const char *what, dipole_error *error);

/* Frees all requests and the frame that is being received. */
void libdipole_requests_free(dipole_client *client);

/* ---- for connecting ------------------------------------------------------------------------ */

/* Returns whether connecting again may help after this error. */
bool libdipole_is_temporary(const dipole_error *error);

#endif

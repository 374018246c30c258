/* request: sends requests, receives answers, and sends again what met trouble. It knows no kind of
 * message: a libdipole_kind tells how the answer to one is taken.
 *
 * A request is begun and sent, waits in client->pending until its answer is whole, and is then
 * handed out to the call that waits for it. With retries, a copy of it is kept until then. It is
 * sent again on another connection when the first one is lost, or on the same one when the daemon
 * was busy. Answers of a lost connection cannot come any more, and of an unfinished answer nothing
 * is used, so no answer is wrong and none comes twice. */
#ifndef LIBDIPOLE_REQUEST_H
#define LIBDIPOLE_REQUEST_H

#include <sys/types.h>

#include "clients/c/address.h"
#include "clients/c/stream.h"
#include "proto/eval.h"
#include "proto/wire.h"

/* Arrays lie in frames as they lie in memory, and frames are little-endian. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "this machine's arrays need swapping");

/* ---- what is asked and answered ------------------------------------------------------------ */

/* A frame that has arrived, or an answer that was put together of several frames. The result comes
 * first, so that the caller's result is the block that holds the payload. Behind the payload there
 * is room for the result's channels. Of an answer that goes into the caller's memory, only the head
 * is stored: the fixed part and the channels. */
typedef struct libdipole_frame {
  dipole_result result;
  wire_header header;
  uint64_t payload_bytes; /* An answer of several parts may have more than a header can say. */
  uint64_t stored_bytes;  /* how many of them are in payload: all, or the head */
  void *into_values; /* the caller's memory that holds the rest; both are NULL if there is none */
  void *into_radii;
  _Alignas(8) uint8_t payload[];
} libdipole_frame;

/* The caller's function that gets the parts of an answer as they come. */
typedef struct libdipole_reader {
  bool (*part)(void *context, const dipole_result *part, uint64_t radius_first);
  void *context;
  bool stopped; /* The function wants no more. */
} libdipole_reader;

typedef struct libdipole_pending libdipole_pending;

/* How the answers to one kind of request are taken. A function that is NULL is not needed. */
typedef struct libdipole_kind {
  /* Every daemon gives the same right answer, however often it is asked: so it can be sent
   * again. */
  bool repeatable;
  /* The call's time limit does not apply to this kind of request. */
  bool endless;
  /* Takes the next frame of an answer of several over. When the answer is whole, it is in
   * pending->frame. NULL: every answer is one frame. */
  bool (*take)(libdipole_pending *pending, libdipole_frame *frame, dipole_error *error);
  /* Returns whether this frame only reports progress. It is handed out, and more frames follow. */
  bool (*is_progress)(const libdipole_frame *frame);
  /* The stream's target is full: sets the next one of the frame. *more: false if that was all.
   * NULL: a frame's whole payload is stored in the frame. */
  bool (*place)(dipole_client *client, libdipole_pending *pending, bool *more, dipole_error *error);
  /* The request has been dropped: the rest of the frame must not go into the caller's memory. */
  void (*discard)(dipole_client *client, libdipole_pending *pending);
} libdipole_kind;

/* A repeatable request whose answer is one frame. */
extern const libdipole_kind libdipole_plain;

/* A request whose answer has not been handed out, and what the answer may look like. Whoever begins
 * it sets the fields of the first group. */
struct libdipole_pending {
  const libdipole_kind *kind;
  uint16_t type; /* enum wire_type */
  uint32_t deadline_ms;
  uint64_t reply_bytes_min, reply_bytes_max; /* of the payload of one frame */
  uint16_t model, evaluator, wanted;         /* of an eval or sample */
  uint32_t medium_count;                     /* 0 if the request lists none */
  uint64_t radius_count;                     /* of an eval or sample; of an invert: its media */
  libdipole_reader *reader; /* gets each part as it comes; if NULL, the parts are put together */
  void *into_values;        /* see dipole_query */
  void *into_radii;

  uint64_t id;
  libdipole_frame *frame;    /* the answer; NULL if it is not here yet */
  uint32_t next_part;        /* what the next part of the answer has to be */
  uint64_t next_radius;      /* likewise: the position of its first radius or medium */
  libdipole_frame *gathered; /* the parts so far; with a reader, without the arrays */
  bool dropped;              /* The caller has dropped the request: do not use reader and into_*. */

  size_t frame_bytes;
  uint8_t *kept;      /* [frame_bytes] the request as it was sent; NULL: it cannot be sent again */
  int64_t sent_ms;    /* when it was first sent, if it has a deadline */
  int64_t trouble_ms; /* when it first got no answer; 0 if that has not happened */
  int64_t again_ms;   /* when it is to be sent again; 0 if it has been sent */
};

/* The arrays of a frame that is received into the caller's memory. */
typedef struct libdipole_into {
  bool begun;            /* The head is here, and it is valid. */
  wire_eval_reply fixed; /* the head */
  uint64_t array_count;  /* in the frame, radii included */
  uint64_t array_bytes;  /* of each, padding included */
  uint64_t array;        /* the one under way */
  uint64_t done_bytes;   /* how many of its bytes have been given a place */
  uint8_t discarded[16384];
} libdipole_into;

/* How a client connects again and sends again. */
typedef struct libdipole_retry {
  unsigned for_ms;    /* how long it tries; 0 is not at all */
  unsigned pause_ms;  /* the next pause while there is no connection; else 0 */
  size_t kept_bytes;  /* of the copies of all requests */
  size_t later_count; /* how many requests wait to be sent again */
  uint64_t random;    /* see libdipole_random() */
} libdipole_retry;

struct dipole_client {
  libdipole_stream stream;
  pid_t daemon; /* a private daemon, or 0 */
  unsigned connect_timeout_ms, timeout_ms, call_timeout_ms, in_flight_max;
  int64_t until_ms;    /* when the call under way has to end; 0 is never */
  unsigned waited_ms;  /* by calls that ended before the daemon's answer */
  dipole_error lost;   /* why there is no connection; kind NONE if there is one */
  dipole_error broken; /* why there never will be; kind NONE if the client works */
  libdipole_addresses addresses;
  libdipole_retry retry;

  /* Opens a client at the first of the addresses that works, once each, until until_ms. NULL:
   * *may_pass says whether trying again may help, and *error why it failed. */
  dipole_client *(*reopen)(dipole_client *client, int64_t until_ms, bool *may_pass,
                           dipole_error *error);

  /* pending[pending_begin .. pending_begin + pending_count], in the order of their ids */
  uint64_t last_id;
  libdipole_pending *pending;
  size_t pending_begin, pending_count, pending_capacity;
  size_t arrived_count;   /* how many of them have an answer */
  size_t dropped_count;   /* how many of them nobody wants */
  size_t held_count;      /* how many have been begun since bytes were last sent */
  libdipole_frame *frame; /* being received; NULL: a header comes next */
  libdipole_into into;

  dipole_info *info; /* one block; NULL before the daemon has said hello */
};

/* ---- one request --------------------------------------------------------------------------- */

/* Begins a call: its time runs from now on. */
void libdipole_call_begin(dipole_client *client, const libdipole_kind *kind);

/* Begins a request. *payload is room for payload_bytes: the caller fills it before it calls
 * libdipole_request_send(). Sets pending->id. */
bool libdipole_request_begin(dipole_client *client, libdipole_pending *pending,
                             uint64_t payload_bytes, uint8_t **payload, dipole_error *error);

/* Sends the request that was begun last. It waits only if too many bytes are unsent. */
bool libdipole_request_send(dipole_client *client, dipole_error *error);

/* Waits for the answer to request id, or to any request if id is 0, and hands it out in *pending.
 * The caller frees pending->frame, which may be an error frame. After a report of progress the
 * request goes on. */
bool libdipole_request_wait(dipole_client *client, uint64_t id, libdipole_pending *pending,
                            dipole_error *error);

/* Waits until a request's reader has got all parts of the answer, or wants no more, or an error
 * frame has ended the answer. The caller frees pending->frame, which is NULL if more may come. */
bool libdipole_request_read(dipole_client *client, uint64_t id, const libdipole_reader *reader,
                            libdipole_pending *pending, dipole_error *error);

/* Waits for the answer to request pending->id. Returns its frame, which the caller frees; NULL if
 * it failed or was refused. */
libdipole_frame *libdipole_reply(dipole_client *client, libdipole_pending *pending,
                                 dipole_error *error);

/* Sends a request with this payload and waits for its answer, as libdipole_reply(). */
libdipole_frame *libdipole_ask(dipole_client *client, libdipole_pending *pending,
                               const uint8_t *payload, size_t payload_bytes, dipole_error *error);

/* Gives up a request. If its answer is still to come, it is thrown away then. */
void libdipole_request_drop(dipole_client *client, uint64_t id);

/* Returns whether the answer is no error frame; else *error is what that says. */
bool libdipole_refusal_check(const dipole_client *client, const libdipole_pending *pending,
                             dipole_error *error);

/* ---- for kinds of answers ------------------------------------------------------------------ */

/* Makes a frame with this header. payload_bytes: of the answer. stored_bytes: room for those that
 * are stored. channel_count: room for so many channels. NULL if there is no memory. */
libdipole_frame *libdipole_frame_new(const wire_header *header, uint64_t payload_bytes,
                                     uint64_t stored_bytes, uint32_t channel_count,
                                     dipole_error *error);

/* A part has been taken. When it was the last, what was gathered becomes the answer. */
void libdipole_part_end(libdipole_pending *pending, uint64_t count, bool is_last);

/* Fails with kind PROTOCOL, after which the client can only be closed. Returns false. */
bool libdipole_bad_answer(dipole_client *client, const char *what, dipole_error *error);

/* Frees all requests and what is being received. */
void libdipole_requests_free(dipole_client *client);

/* ---- for connecting ------------------------------------------------------------------------ */

/* Whether what ended a connection, or prevented one, may be over soon. */
bool libdipole_is_temporary(const dipole_error *error);

#endif

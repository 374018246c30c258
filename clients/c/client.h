/* client: what the files of libdipole share among themselves. Not installed. The names start with
 * libdipole_ so that they neither leave the shared library (which exports dipole_*) nor meet names
 * of the program that links the static one. */
#ifndef LIBDIPOLE_CLIENT_H
#define LIBDIPOLE_CLIENT_H

#include <limits.h>
#include <poll.h>
#include <sys/types.h>

#include "clients/c/dipole.h"
#include "proto/eval.h"
#include "proto/wire.h"

/* ---- error.c ------------------------------------------------------------------------------- */

/* Fills *error and returns false. */
bool libdipole_fail(dipole_error *error, enum dipole_error_kind kind, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* The same for a call of the system; its errno is told. */
bool libdipole_fail_errno(dipole_error *error, enum dipole_error_kind kind, int number,
                          const char *what);

/* ---- clock.c ------------------------------------------------------------------------------- */

int64_t libdipole_now_ms(void); /* since some moment in the past; never set back */

/* poll() for one descriptor, started again after a signal. False: timed out, with errno ETIMEDOUT,
 * or failed, with errno. timeout_ms 0: for ever. */
bool libdipole_wait(int fd, short events, unsigned timeout_ms, short *ready);

/* ---- text.c -------------------------------------------------------------------------------- */

/* Replaces what is no printable UTF-8 by question marks: a peer's text may go to a terminal. */
void libdipole_clean_text(char *text);

/* ---- address.c ----------------------------------------------------------------------------- */

enum libdipole_address_kind { LIBDIPOLE_UNIX, LIBDIPOLE_TCP, LIBDIPOLE_PRIVATE };

typedef struct libdipole_address {
  enum libdipole_address_kind kind;
  char host[256]; /* TCP */
  char port[6];
  char path[PATH_MAX]; /* Unix: the socket; private: the program, "" for any */
} libdipole_address;

/* The address to use when the caller names none. */
const char *libdipole_address_default(void);

bool libdipole_address_parse(const char *text, libdipole_address *address, dipole_error *error);

/* ---- addresses.c --------------------------------------------------------------------------- */

enum { LIBDIPOLE_PAUSE_FIRST_MS = 10, LIBDIPOLE_PAUSE_MOST_MS = 1000 };

/* The addresses of a client, at least one, and which one is connected to or tried first. */
typedef struct libdipole_addresses {
  char *whole; /* the texts, one behind the other */
  size_t count;
  size_t at;
  const char *texts[DIPOLE_ADDRESSES_MAX];
} libdipole_addresses;

/* Takes a list apart; to be freed, also after a failure. */
bool libdipole_addresses_parse(const char *text, libdipole_addresses *addresses,
                               dipole_error *error);
bool libdipole_addresses_is_private(const libdipole_addresses *addresses);
void libdipole_addresses_free(libdipole_addresses *addresses);

/* *state: 0 at first. */
uint32_t libdipole_random(uint64_t *state);

/* Between half and all of a pause, so that clients that lost the same daemon at the same moment do
 * not all come back at the same moment. */
unsigned libdipole_jitter(uint64_t *state, unsigned pause_ms);

/* The pause after this one. */
unsigned libdipole_pause_twice(unsigned pause_ms);

/* ---- connect.c ----------------------------------------------------------------------------- */

/* Connects to a Unix socket or a TCP address; *fd is then non-blocking. timeout_ms 0: for ever; it
 * does not hold for finding a host's addresses. */
bool libdipole_connect(const libdipole_address *address, unsigned timeout_ms, int *fd,
                       dipole_error *error);

/* ---- daemon.c ------------------------------------------------------------------------------ */

/* Starts a dipoled of our own at the other end of *fd (non-blocking). program "": see dipole.h. */
bool libdipole_daemon_start(const char *program, int *fd, pid_t *pid, dipole_error *error);

/* Waits for a private daemon whose connection has been closed, and ends it if it does not end. */
void libdipole_daemon_end(pid_t pid);

/* ---- stream.c ------------------------------------------------------------------------------ */

enum { LIBDIPOLE_INPUT_BYTES = 65536 };

/* A non-blocking socket with buffers. Bytes that arrive go to `target` while target_bytes > 0 (and
 * the buffer has been emptied before it was set), else to the buffer in[in_begin .. in_end]. */
typedef struct libdipole_stream {
  int fd;
  int send_errno; /* sending has failed; what the peer still says is read before that is told */
  bool silent;    /* a step ended because nothing moved, and not because of the peer */
  uint8_t *out;   /* unsent: out[out_begin .. out_end] */
  size_t out_begin, out_end, out_capacity;
  uint8_t *target;
  size_t target_bytes;
  size_t in_begin, in_end;
  uint8_t in[LIBDIPOLE_INPUT_BYTES];
} libdipole_stream;

void libdipole_stream_init(libdipole_stream *stream, int fd);
void libdipole_stream_close(libdipole_stream *stream);

/* Room for bytes more at out + out_end; the caller adds to out_end what it wrote there. */
bool libdipole_stream_reserve(libdipole_stream *stream, size_t bytes, dipole_error *error);

/* Sends what the socket takes at once. */
void libdipole_stream_send(libdipole_stream *stream);

/* Waits until a byte can be read or sent, and reads and sends once. Reading goes on while there is
 * something to send: two peers that only send would wait for each other for ever. */
bool libdipole_stream_step(libdipole_stream *stream, unsigned timeout_ms, dipole_error *error);

/* ---- what is asked and answered ------------------------------------------------------------ */

/* A frame that has arrived, or an answer that was put together of several. The result comes first,
 * so that the caller's result is the block that holds the payload; after the payload there is room
 * for the result's channels. Of an answer into the caller's memory only the head is held, the fixed
 * part and the channels. */
typedef struct libdipole_frame {
  dipole_result result;
  wire_header header;
  uint64_t payload_bytes; /* of several parts more than a header can say */
  uint64_t stored_bytes;  /* of them, those that are in payload: all, or the head */
  void *into_values;      /* where the rest is then; NULL in all other frames */
  void *into_radii;
  _Alignas(8) uint8_t payload[];
} libdipole_frame;

/* Who is handed the parts of an answer as they come. */
typedef struct libdipole_reader {
  bool (*part)(void *context, const dipole_result *part, uint64_t radius_first);
  void *context;
  bool stopped; /* wants no more */
} libdipole_reader;

/* A request whose answer has not been handed out, and what the answer may look like. */
typedef struct libdipole_pending {
  uint64_t id;
  uint16_t type;
  uint32_t deadline_ms;
  uint64_t reply_bytes_min, reply_bytes_max; /* of the payload of one frame */
  uint16_t model, evaluator, wanted;         /* these three: eval and sample only */
  uint32_t medium_count;                     /* these two: 0 where there is no list of them */
  uint64_t radius_count;                     /* of an invert: how many media */
  libdipole_frame *frame;                    /* the answer; NULL: not here yet */

  /* Of an answer that comes in parts: what the next one has to be; */
  uint32_t next_part;
  uint64_t next_radius;
  libdipole_frame *gathered; /* what has come so far; with a reader, without the arrays */
  libdipole_reader *reader;  /* NULL: the parts are put together */
  bool dropped;              /* nobody wants the rest any more; reader, into_* are gone */
  void *into_values;         /* see dipole_query; both NULL: the result holds its arrays */
  void *into_radii;

  /* For asking again: */
  size_t frame_bytes;
  uint8_t *kept;   /* [frame_bytes], the request as it was sent; NULL: it cannot be asked again */
  int64_t sent_ms; /* with a deadline: when it was first sent */
  int64_t trouble_ms; /* when it first got no answer; 0: has not happened */
  int64_t again_ms;   /* when it is to be sent again; 0: it is sent */
} libdipole_pending;

/* How a client connects and asks again. */
typedef struct libdipole_retry {
  unsigned for_ms;    /* 0: it does not */
  unsigned pause_ms;  /* the next, while there is no connection; else 0 */
  size_t kept_bytes;  /* of all outstanding requests */
  size_t later_count; /* of them, those that wait to be sent again */
  uint64_t random;    /* 0: not begun */
} libdipole_retry;

/* The arrays of the frame that is being received into the caller's memory. */
typedef struct libdipole_into {
  bool begun;            /* the head is here, and good */
  wire_eval_reply fixed; /* what it says */
  uint64_t array_count;  /* in the frame, radii included */
  uint64_t array_bytes;  /* of each, padding included */
  uint64_t array;        /* the one under way, and its bytes that have a place by now */
  uint64_t done_bytes;
  uint8_t discarded[16384]; /* the place of what nobody wants */
} libdipole_into;

struct dipole_client {
  libdipole_stream stream;
  pid_t daemon; /* a private daemon; 0: none */
  unsigned connect_timeout_ms, timeout_ms, call_timeout_ms, in_flight_max;
  int64_t until_ms;    /* when the call under way has to end; 0: never */
  unsigned waited_ms;  /* in vain, by calls that are over */
  dipole_error lost;   /* why there is no connection; kind NONE: there is one */
  dipole_error broken; /* why there never will be; kind NONE: the client works */
  libdipole_addresses addresses;
  libdipole_retry retry;

  /* pending[pending_begin .. pending_begin + pending_count], by ascending id */
  uint64_t last_id;
  libdipole_pending *pending;
  size_t pending_begin, pending_count, pending_capacity;
  size_t arrived_count;   /* of those, with an answer */
  size_t dropped_count;   /* of those, dropped */
  size_t held_count;      /* begun since bytes were last sent */
  libdipole_frame *frame; /* being received; NULL: a header is next */
  libdipole_into into;

  char *address;    /* of the connection that was there first */
  dipole_info info; /* points into the next four and hello */
  wire_hello_reply hello;
  dipole_choice *choices;
  wire_choice *choice_texts;
  dipole_value *limits;
  wire_value *limit_texts;
};

/* ---- pending.c ----------------------------------------------------------------------------- */

/* The request with this id; NULL: there is none. */
libdipole_pending *libdipole_pending_find(dipole_client *client, uint64_t id);

/* The oldest one that has an answer; NULL: none has. */
libdipole_pending *libdipole_pending_arrived(dipole_client *client);

/* Room for one more. */
bool libdipole_pending_reserve(dipole_client *client, dipole_error *error);

/* Whether this is progress of a job: more frames of its answer follow. */
bool libdipole_is_progress(const libdipole_frame *frame);

/* Hands an entry out that has an answer. After progress of a job it stays. */
void libdipole_pending_take(dipole_client *client, libdipole_pending *entry,
                            libdipole_pending *out);

/* Nobody will ask for the answer to this request, if there is such a one: it is thrown away when it
 * comes, and until then the request counts as dropped. */
void libdipole_pending_drop(dipole_client *client, uint64_t id);

/* Takes an entry out, wherever it stands. */
void libdipole_pending_remove(dipole_client *client, libdipole_pending *entry);

void libdipole_pending_free(dipole_client *client);

/* ---- receive.c ----------------------------------------------------------------------------- */

/* Makes frames of the bytes in the buffer. */
bool libdipole_receive(dipole_client *client, dipole_error *error);

/* Room for a frame with this header, of whose payload so many bytes are to be stored, and so many
 * channels; NULL: there is none. */
libdipole_frame *libdipole_frame_new(const wire_header *header, uint64_t payload_bytes,
                                     uint64_t stored_bytes, uint32_t channel_count,
                                     dipole_error *error);

/* ---- into.c -------------------------------------------------------------------------------- */

/* Whether there is a place for all that is wanted, or for none of it. */
bool libdipole_into_check(const dipole_query *query, dipole_error *error);

/* Whether a frame is part of an answer that goes into the caller's memory; pending may be NULL. */
bool libdipole_into_is(const libdipole_pending *pending, const wire_header *header);

/* The stream's target is filled: sets the next one of the frame. *more: false: it is whole. */
bool libdipole_into_next(dipole_client *client, bool *more, dipole_error *error);

/* The caller's memory is not to be written any more for this request, which has been dropped. */
void libdipole_into_discard(dipole_client *client, uint64_t id);

/* ---- request.c ----------------------------------------------------------------------------- */

/* A call begins, of which so much is known as what it asks: its time runs. */
void libdipole_call_begin(dipole_client *client, uint16_t type);

/* Makes *limit_ms (0: for ever) what is left of the call's time if that is less. False: nothing. */
bool libdipole_call_left(const dipole_client *client, unsigned *limit_ms, dipole_error *error);

/* Starts a request: *payload is room for payload_bytes, to be filled before request_send(). What
 * the answer may look like is taken from *pending; its id is set. */
bool libdipole_request_begin(dipole_client *client, libdipole_pending *pending,
                             uint64_t payload_bytes, uint8_t **payload, dipole_error *error);

/* Sends it, as far as that needs no wait or the backlog has grown too long. */
bool libdipole_request_send(dipole_client *client, dipole_error *error);

/* Waits for the answer to request id, or to any request when id is 0, and hands it out: frame, to
 * be freed by the caller, is then in *pending. The parts of an eval's answer are one answer. An mc
 * request is answered again and again: the latest is handed out, and until that is the last one the
 * request goes on. */
bool libdipole_request_wait(dipole_client *client, uint64_t id, libdipole_pending *pending,
                            dipole_error *error);

/* Waits until the answer to request id has been handed to the reader, part by part, or has ended
 * with an error, which is then pending->frame, or the reader wants no more. The frame is to be
 * freed, and NULL when more of the answer may come. */
bool libdipole_request_read(dipole_client *client, uint64_t id, const libdipole_reader *reader,
                            libdipole_pending *pending, dipole_error *error);

/* Waits for the answer to the request pending->id, which has one part; NULL when that is an error
 * frame; to be freed. */
libdipole_frame *libdipole_reply(dipole_client *client, libdipole_pending *pending,
                                 dipole_error *error);

/* A request with this payload and its answer, which is no error frame; to be freed. */
libdipole_frame *libdipole_ask(dipole_client *client, libdipole_pending *pending,
                               const uint8_t *payload, size_t payload_bytes, dipole_error *error);

/* Says in *error what an error frame says. Returns false. */
bool libdipole_refused(const dipole_client *client, const libdipole_pending *pending,
                       const libdipole_frame *frame, dipole_error *error);

/* ---- retry.c ------------------------------------------------------------------------------- */

/* Keeps the request that was begun last, whose frame is the end of stream.out, if it may be sent
 * again and there is room. */
void libdipole_retry_keep(dipole_client *client);

/* Frees what is kept of it. */
void libdipole_retry_forget(dipole_client *client, libdipole_pending *pending);

/* Whether this answer says no more than that the request is to be asked later, which then will
 * happen; frees the frame in that case. */
bool libdipole_retry_later(dipole_client *client, libdipole_pending *pending,
                           libdipole_frame *frame);

/* With retry.later_count > 0: sends what is to be sent by now, and waits for the connection to move
 * while that takes no longer than until the next is to be sent. *moves: there may be something to
 * read or send. */
bool libdipole_retry_wait(dipole_client *client, bool *moves, dipole_error *error);

/* Whether the answer to this type of request is the same whoever gives it, however often. */
bool libdipole_retry_is_safe(uint16_t type);

/* Whether this request can be sent again: it is kept, and nothing has been handed on to a reader. */
bool libdipole_retry_can(const libdipole_pending *pending);

/* When it first had no answer, at the latest now: from then on its time runs. */
int64_t libdipole_retry_trouble_ms(libdipole_pending *pending, int64_t now_ms);

/* Forgets the parts of its answer that have come. */
void libdipole_retry_drop_parts(libdipole_pending *pending);

/* Sends it again, with what is left of its deadline; when nothing is, it has an answer: that. */
bool libdipole_retry_send(dipole_client *client, libdipole_pending *pending, dipole_error *error);

/* ---- open.c -------------------------------------------------------------------------------- */

/* Whether what ended a connection, or kept one from being made, may be over soon. */
bool libdipole_may_pass(const dipole_error *error);

/* Tries each of the addresses once, from addresses->at on, which is then the one that it got;
 * until_ms: all of it has to be over by then; INT64_MAX: never. like: NULL, or whose lists the
 * daemon must have. NULL: none can be had; *may_pass: some day one may. The new client has no
 * addresses and options yet. */
dipole_client *libdipole_round(libdipole_addresses *addresses, unsigned connect_timeout_ms,
                               int64_t until_ms, const dipole_client *like, bool *may_pass,
                               dipole_error *error);

void libdipole_sleep_ms(int64_t ms);

/* ---- restore.c ----------------------------------------------------------------------------- */

/* After *error: connects again and sends all that is outstanding. False: that is not possible, and
 * *error says why the connection was lost; or, with kind TIMEOUT, the call's time is over, and the
 * next one goes on. */
bool libdipole_restore(dipole_client *client, dipole_error *error);

/* ---- sample.c ------------------------------------------------------------------------------ */

/* What is wanted, as proto/eval.h has it: whether radii are drawn depends on the message. */
unsigned libdipole_wanted(uint16_t type, unsigned wanted);

/* ---- invert.c ------------------------------------------------------------------------------ */

/* As libdipole_part_take(), of the answer to an invert request. */
bool libdipole_media_take(libdipole_pending *pending, libdipole_frame *frame, dipole_error *error);

/* ---- query.c ------------------------------------------------------------------------------- */

/* What a frame's layout depends on. */
bool libdipole_parameters_check(const dipole_parameter *parameters, size_t count,
                                dipole_error *error);
bool libdipole_media_check(const dipole_medium *media, uint32_t medium_count, unsigned evaluator,
                           dipole_error *error);

/* Listed numbers in the precision of an evaluator that is known; *bytes: of all of them. */
bool libdipole_list_check(const void *list, uint64_t count, unsigned evaluator, const char *name,
                          const char *count_name, uint64_t *bytes, dipole_error *error);

/* These return what follows the bytes that they write. */
uint8_t *libdipole_parameters_put(uint8_t *at, const dipole_parameter *parameters, size_t count);
uint8_t *libdipole_medium_put(uint8_t *at, const dipole_medium *medium);

/* Checks a query, as far as the frame's layout depends on it, and sends it. *pending: its type and
 * what the answer may look like are given, the counts and the id are set. */
bool libdipole_query_send(dipole_client *client, const dipole_query *query,
                          libdipole_pending *pending, dipole_error *error);

/* ---- parts.c ------------------------------------------------------------------------------- */

/* Whether a frame is part of an answer that has others, or that is to be read part by part; or of
 * one to an invert, whose frames are all looked at so. */
bool libdipole_part_is(const libdipole_pending *pending, const libdipole_frame *frame);

/* Takes the next part over. When it was the last, pending->frame is the whole answer, of which with
 * a reader or when dropped only the beginning is left. */
bool libdipole_part_take(libdipole_pending *pending, libdipole_frame *frame, dipole_error *error);

/* ---- result.c ------------------------------------------------------------------------------ */

/* Whether a frame is the next part of the answer, or all of it, in the shape that was asked for: so
 * that a caller who indexes with its own counts stays inside the arrays. */
bool libdipole_answer_parse(const libdipole_pending *pending, const libdipole_frame *frame,
                            wire_eval_reply *fixed, eval_layout *layout, dipole_error *error);

/* Makes frame->result out of the frame's own payload. */
const dipole_result *libdipole_result_make(libdipole_frame *frame, const wire_eval_reply *fixed,
                                           const eval_layout *layout);

/* An error frame in place of an answer is told; true: it is none. */
bool libdipole_refusal_check(const dipole_client *client, const libdipole_pending *pending,
                             dipole_error *error);

/* Makes the result out of the answer to an eval request; takes pending->frame over. */
bool libdipole_result_take(dipole_client *client, libdipole_pending *pending,
                           dipole_result **result, dipole_error *error);

/* ---- info.c -------------------------------------------------------------------------------- */

/* Says hello and fills client->info. */
bool libdipole_hello(dipole_client *client, dipole_error *error);
void libdipole_info_free(dipole_client *client);

#endif

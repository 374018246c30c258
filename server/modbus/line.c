#include "server/modbus/line.h"

#include <errno.h>
#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/net/worker.h"
#include "server/observe/log.h"

enum {
  CHARACTER_BITS = 11, /* the most bits of a character, with start, parity and stop bits */
  SILENCE_LEAST_MS = 2,
  RETRY_FIRST_MS = 250,
  RETRY_MOST_MS = 30000,
};

#define DIGITS "0123456789"

static void lose_device(struct modbus_line *line, const char *why);

static struct modbus_line *line_of(struct client *client) {
  return (struct modbus_line *)(void *)client;
}

static struct stats *stats_of(const struct modbus_line *line) {
  return &line->units->server->stats;
}

/* ---- the option ------------------------------------------------------------------------------ */

static bool complain(const char *url, const char *why) {
  fprintf(stderr, "dipoled: --modbus %s: %s\n", url, why);
  return false;
}

static bool is_baud_rate(int baud) {
  static const int rates[] = {1200,  2400,   4800,   9600,   19200, 38400,
                              57600, 115200, 230400, 460800, 921600};
  for (size_t i = 0; i < sizeof rates / sizeof rates[0]; i++) {
    if (rates[i] == baud) {
      return true;
    }
  }
  return false;
}

/* Reads the option. Returns false and prints which part of the option is wrong. */
static bool read_url(struct modbus_line *line, const char *url) {
  char baud[8] = "", parity[4] = "", unit[4] = "1", rest = '\0';
  _Static_assert(MODBUS_LINE_DEVICE_BYTES == 256, "the width in the format");
  const int parts =
      sscanf(url, "rtu:%255[^,],%7[^,],%3[^,],%3[^,]%c", line->device, baud, parity, unit, &rest);
  line->baud = atoi(baud);
  line->parity = parity[0];
  line->number = (unsigned)atoi(unit);
  if (parts < 3) {
    return complain(url, "the form is rtu:DEVICE,BAUD,PARITY[,UNIT]");
  }
  if (strspn(baud, DIGITS) != strlen(baud) || !is_baud_rate(line->baud)) {
    return complain(url, "BAUD is 1200, 2400, 4800, ... 115200, 230400, 460800 or 921600");
  }
  if (strlen(parity) != 1 || strchr("NEO", line->parity) == NULL) {
    return complain(url, "PARITY is N, E or O");
  }
  const bool number_is_there = url[strlen(url) - 1] != ',' && parts <= 4;
  if (!number_is_there || strspn(unit, DIGITS) != strlen(unit) || line->number < 1 ||
      line->number > MODBUS_UNITS) {
    return complain(url, "UNIT is 1 to 247");
  }
  return true;
}

/* ---- the device ------------------------------------------------------------------------------ */

/* Opens the device by libmodbus: non-blocking, and for this process alone. */
static bool open_device(struct modbus_line *line) {
  line->context = modbus_new_rtu(line->device, line->baud, line->parity, 8, 1);
  if (line->context == NULL) {
    return false;
  }
  modbus_set_slave(line->context, (int)line->number);
  if (modbus_connect(line->context) == 0) {
    return true;
  }
  const int error = errno;
  modbus_free(line->context);
  line->context = NULL;
  errno = error;
  return false;
}

static void close_device(struct modbus_line *line) {
  if (line->context != NULL) {
    modbus_close(line->context);
    modbus_free(line->context);
    line->context = NULL;
  }
}

void modbus_line_close(struct modbus_line *line) {
  close_device(line);
}

/* ---- answering ------------------------------------------------------------------------------- */

static uint8_t *frame_of(struct modbus_line *line) {
  return line->input + line->frame_begin;
}

static size_t pdu_bytes(const struct modbus_line *line) {
  return line->frame_end - line->frame_begin - 3;
}

static bool is_broadcast(struct modbus_line *line) {
  return frame_of(line)[0] == MODBUS_BROADCAST_ADDRESS;
}

/* Sends an answer, whose PDU begins at frame[1]; a broadcast gets none. If the device does not take
 * the whole answer, it is lost, as it could be on the line. */
static void send_answer(struct modbus_line *line, uint8_t frame[MODBUS_RTU_MAX], size_t bytes) {
  frame[0] = (uint8_t)line->number;
  const uint16_t sum = modbus_rtu_checksum(frame, 1 + bytes);
  frame[1 + bytes] = (uint8_t)sum;
  frame[2 + bytes] = (uint8_t)(sum >> 8);
  if (line->context == NULL || is_broadcast(line)) {
    return;
  }
  const ssize_t sent = write(modbus_get_socket(line->context), frame, 3 + bytes);
  if (sent > 0) {
    stats_add(stats_of(line), STATS_SENT_BYTES, (uint64_t)sent);
  } else {
    log_peer_line(LOG_LEVEL_INFO, "event=modbus-answer-lost device=%s reason=%s", line->device,
                  strerror(errno));
  }
}

static void answer(struct modbus_line *line) {
  uint8_t frame[MODBUS_RTU_MAX];
  const uint8_t *pdu = frame_of(line) + 1;
  struct modbus_unit *unit = NULL;
  if (is_broadcast(line) && !modbus_pdu_writes(pdu[0])) {
    return;
  }
  const size_t answered = modbus_answer(line->units, &line->client, line->number, pdu,
                                        pdu_bytes(line), frame + 1, &unit);
  if (answered > 0) {
    send_answer(line, frame, answered);
  } else {
    line->waits_for = unit;
  }
}

/* Answers the request whose commit has been evaluated. */
static void answer_late(struct modbus_line *line) {
  uint8_t frame[MODBUS_RTU_MAX];
  const size_t answered =
      modbus_answer_late(line->waits_for, frame_of(line) + 1, pdu_bytes(line), frame + 1);
  line->waits_for = NULL;
  line->bytes = 0;
  send_answer(line, frame, answered);
}

/* Called after a silence: answers a request in the bytes that have arrived, or drops them. */
static void run(struct client *client) {
  struct modbus_line *line = line_of(client);
  if (line->context == NULL || line->waits_for != NULL) {
    return;
  }
  size_t begin;
  const size_t bytes = modbus_rtu_find(line->input, line->bytes, line->number, &begin);
  const bool noise = begin == line->bytes && line->bytes > 0;
  if (bytes > 0 && line->input[begin + 1] < 0x80) {
    line->frame_begin = (unsigned)begin;
    line->frame_end = (unsigned)(begin + bytes);
    answer(line);
  } else if (noise) {
    stats_add(stats_of(line), STATS_MODBUS_BAD_FRAMES, 1);
  }
  if (line->waits_for == NULL) {
    line->bytes = 0;
  }
}

/* ---- reading --------------------------------------------------------------------------------- */

/* Returns whether the bytes that have arrived end with a complete request. */
static bool is_whole(const struct modbus_line *line) {
  size_t begin;
  return modbus_rtu_find(line->input, line->bytes, line->number, &begin) > 0;
}

static void on_silence(uv_timer_t *timer) {
  struct modbus_line *line = timer->data;
  worker_run_later(&line->client);
  worker_stay_awake(line->client.worker); /* This turn comes only after the next poll. */
}

static void arrived(struct modbus_line *line, size_t bytes) {
  const struct options *options = &line->units->server->options;
  stats_add(stats_of(line), STATS_RECEIVED_BYTES, bytes);
  line->bytes += (unsigned)bytes;
  line->retry_ms = RETRY_FIRST_MS;
  const uint64_t wait_ms = is_whole(line) ? line->silence_ms : options->modbus_gap_ms;
  uv_timer_start(&line->timer, on_silence, wait_ms, 0);
}

static void on_poll(uv_poll_t *poll, int status, int events) {
  (void)events;
  struct modbus_line *line = poll->data;
  if (status < 0) {
    lose_device(line, uv_strerror(status));
    return;
  }
  if (line->client.to_run) {
    return; /* Read these bytes in the next round, after the answer to the earlier request. */
  }
  if (line->bytes == sizeof line->input) { /* Four frames without a silence are noise. */
    line->bytes = 0;
  }
  const ssize_t got = read(modbus_get_socket(line->context), line->input + line->bytes,
                           sizeof line->input - line->bytes);
  if (got > 0) {
    arrived(line, (size_t)got);
  } else if (got == 0) {
    lose_device(line, "end-of-file");
  } else if (errno != EAGAIN && errno != EINTR) {
    lose_device(line, strerror(errno));
  }
}

/* ---- starting, losing, stopping -------------------------------------------------------------- */

static void note_closed(struct modbus_line *line) {
  if (--line->open_handles == 0) {
    worker_forget(&line->client);
    modbus_units_leave(line->units, &line->client);
  }
}

static void on_timer_closed(uv_handle_t *handle) {
  note_closed(handle->data);
}

/* Closes the device after its poll: the loop knows the device by its descriptor until then. */
static void on_poll_closed(uv_handle_t *handle) {
  struct modbus_line *line = handle->data;
  close_device(line);
  line->polling = false;
  note_closed(line);
}

static void close_poll(struct modbus_line *line) {
  if (line->polling && !uv_is_closing((uv_handle_t *)&line->poll)) {
    uv_close((uv_handle_t *)&line->poll, on_poll_closed);
  }
}

static bool start_polling(struct modbus_line *line) {
  uv_loop_t *loop = worker_loop(line->client.worker);
  if (uv_poll_init(loop, &line->poll, modbus_get_socket(line->context)) != 0) {
    close_device(line);
    return false;
  }
  line->poll.data = line;
  line->polling = true;
  line->open_handles++;
  line->bytes = 0;
  return uv_poll_start(&line->poll, UV_READABLE, on_poll) == 0;
}

static void on_retry(uv_timer_t *timer);

static void retry_later(struct modbus_line *line) {
  uv_timer_start(&line->timer, on_retry, line->retry_ms, 0);
  line->retry_ms = line->retry_ms * 2 < RETRY_MOST_MS ? line->retry_ms * 2 : RETRY_MOST_MS;
}

static void on_retry(uv_timer_t *timer) {
  struct modbus_line *line = timer->data;
  if (line->polling || !open_device(line) || !start_polling(line)) {
    retry_later(line);
    return;
  }
  log_line(LOG_LEVEL_INFO, "event=modbus-device-back device=%s", line->device);
}

static void lose_device(struct modbus_line *line, const char *why) {
  log_peer_line(LOG_LEVEL_ERROR, "event=modbus-device-lost device=%s reason=%s", line->device, why);
  close_poll(line);
  if (line->stopping) {
    worker_run_later(&line->client);
  } else {
    retry_later(line);
  }
}

static void start(struct client *client) {
  struct modbus_line *line = line_of(client);
  modbus_units_join(line->units);
  uv_timer_init(worker_loop(client->worker), &line->timer);
  line->timer.data = line;
  line->open_handles++;
  if (!start_polling(line)) {
    lose_device(line, "poll");
  }
}

/* Called after a turn, and when the unit for which the line waits has its results. */
static void finish(struct client *client) {
  struct modbus_line *line = line_of(client);
  if (line->waits_for != NULL) {
    if (line->waits_for->evaluating) {
      return;
    }
    answer_late(line);
  }
  if (line->stopping && !uv_is_closing((uv_handle_t *)&line->timer)) {
    uv_close((uv_handle_t *)&line->timer, on_timer_closed);
    close_poll(line);
  }
}

/* Stops the line. A request that has been sent is still answered, after a silence, because a device
 * may deliver its bytes late. */
static void stop(struct client *client) {
  struct modbus_line *line = line_of(client);
  if (!line->stopping) {
    line->stopping = true;
    uv_timer_start(&line->timer, on_silence, line->units->server->options.modbus_gap_ms, 0);
  }
}

static void abort_line(struct client *client) {
  line_of(client)->stopping = true;
  worker_run_later(client);
}

bool modbus_line_open(struct modbus_line *line, struct modbus_units *units, const char *url) {
  static const struct client_kind kind = {
      .start = start,
      .run = run,
      .finish = finish,
      .stop = stop,
      .abort = abort_line,
  };
  *line = (struct modbus_line){
      .client.kind = &kind,
      .units = units,
      .retry_ms = RETRY_FIRST_MS,
  };
  if (!read_url(line, url)) {
    return false;
  }
  const uint64_t silence_ms = (7 * CHARACTER_BITS * 1000 / 2 - 1) / (uint64_t)line->baud + 1;
  line->silence_ms = silence_ms > SILENCE_LEAST_MS ? silence_ms : SILENCE_LEAST_MS;
  if (!open_device(line)) {
    return complain(url, modbus_strerror(errno));
  }
  log_line(LOG_LEVEL_INFO, "event=listening url=modbus-rtu:%s,%d,%c,%u", line->device, line->baud,
           line->parity, line->number);
  return true;
}

#include "server/modbus/line.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/observe/log.h"
#include "server/modbus/codec.h"
#include "server/modbus/rtu.h"
#include "server/modbus/service.h"
#include "server/net/worker.h"

enum {
  CHARACTER_BITS = 11, /* at most, with start, parity and stop */
  SILENCE_LEAST_MS = 2,
  RETRY_FIRST_MS = 250,
  RETRY_MOST_MS = 30000,
};

static void on_silence(uv_timer_t *timer);
static void on_evaluated(struct modbus_client *client);
static void lose_device(struct modbus_line *line, const char *why);

/* ---- the option -------------------------------------------------------------------------------
 */

static bool complain(const char *url, const char *why) {
  fprintf(stderr, "dipoled: --modbus %s: %s\n", url, why);
  return false;
}

static bool read_number(const char *text, unsigned long most, unsigned long *number) {
  char *end;
  *number = strtoul(text, &end, 10);
  return *text >= '0' && *text <= '9' && *end == '\0' && *number >= 1 && *number <= most;
}

static bool is_baud_rate(unsigned long baud) {
  static const unsigned long rates[] = {1200,  2400,   4800,   9600,   19200, 38400,
                                        57600, 115200, 230400, 460800, 921600};
  for (size_t i = 0; i < sizeof rates / sizeof rates[0]; i++) {
    if (rates[i] == baud) {
      return true;
    }
  }
  return false;
}

static bool read_url(struct modbus_line *line, const char *url) {
  enum { PARTS = 4 };
  const char *form = "the form is rtu:DEVICE,BAUD,PARITY[,UNIT]";
  char text[MODBUS_LINE_DEVICE_BYTES];
  if (strncmp(url, "rtu:", 4) != 0 || strlen(url) - 4 >= sizeof text) {
    return complain(url, form);
  }
  strcpy(text, url + 4);
  const char *parts[PARTS] = {text, "", "", "1"};
  int count = 1;
  for (char *comma = text; (comma = strchr(comma, ',')) != NULL && count < PARTS; count++) {
    *comma++ = '\0';
    parts[count] = comma;
  }
  unsigned long baud = 0;
  unsigned long unit = 0;
  if (count < 3 || text[0] == '\0') {
    return complain(url, form);
  }
  if (!read_number(parts[1], 921600, &baud) || !is_baud_rate(baud)) {
    return complain(url, "BAUD is 1200, 2400, 4800, ... 115200, 230400, 460800 or 921600");
  }
  if (strlen(parts[2]) != 1 || strchr("NEO", parts[2][0]) == NULL) {
    return complain(url, "PARITY is N, E or O");
  }
  if (!read_number(parts[3], MODBUS_UNITS, &unit)) {
    return complain(url, "UNIT is 1 to 247");
  }
  strcpy(line->device, text);
  line->baud = (int)baud;
  line->parity = parts[2][0];
  line->unit = (unsigned)unit;
  return true;
}

/* ---- the device -------------------------------------------------------------------------------
 */

/* libmodbus opens it, for this process alone and without blocking, and sets it up. */
static bool open_device(struct modbus_line *line) {
  line->context = modbus_new_rtu(line->device, line->baud, line->parity, 8, 1);
  if (line->context == NULL) {
    return false;
  }
  modbus_set_slave(line->context, (int)line->unit);
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

bool modbus_line_open(struct modbus_line *line, struct modbus_service *service, const char *url) {
  *line = (struct modbus_line){.service = service, .retry_ms = RETRY_FIRST_MS};
  line->client.answer = on_evaluated;
  if (!read_url(line, url)) {
    return false;
  }
  const uint64_t silence_ms = (7 * CHARACTER_BITS * 1000 / 2 - 1) / (uint64_t)line->baud + 1;
  line->silence_ms = silence_ms > SILENCE_LEAST_MS ? silence_ms : SILENCE_LEAST_MS;
  if (!open_device(line)) {
    return complain(url, modbus_strerror(errno));
  }
  log_line(LOG_LEVEL_INFO, "event=listening url=modbus-rtu:%s,%d,%c,%u", line->device, line->baud,
           line->parity, line->unit);
  return true;
}

void modbus_line_close(struct modbus_line *line) {
  close_device(line);
}

/* ---- answering --------------------------------------------------------------------------------
 */

static bool is_broadcast(const struct modbus_line *line) {
  return line->input[line->frame_begin] == MODBUS_BROADCAST_ADDRESS;
}

/* A device that takes nothing loses it, as a line does. */
static void note_sent(struct modbus_line *line, ssize_t sent) {
  struct stats *stats = &line->service->server->stats;
  if (sent > 0) {
    stats_add(stats, STATS_SENT_BYTES, (uint64_t)sent);
  } else {
    log_peer_line(LOG_LEVEL_INFO, "event=modbus-answer-lost device=%s reason=%s", line->device,
                  modbus_strerror(errno));
  }
}

static void answer_by_codec(struct modbus_line *line, struct modbus_bank *bank,
                            unsigned exception) {
  const int sent = modbus_codec_answer(line->context, line->input + line->frame_begin,
                                       line->frame_end - line->frame_begin,
                                       bank != NULL ? &bank->mapping : NULL, exception);
  if (!is_broadcast(line)) {
    note_sent(line, sent);
  }
}

static void answer_by_hand(struct modbus_line *line, const struct modbus_answer *answer) {
  uint8_t frame[MODBUS_RTU_MAX];
  frame[0] = (uint8_t)line->unit;
  memcpy(frame + 1, answer->pdu, answer->bytes);
  size_t bytes = 1 + answer->bytes;
  const uint16_t sum = modbus_rtu_checksum(frame, bytes);
  frame[bytes++] = (uint8_t)sum;
  frame[bytes++] = (uint8_t)(sum >> 8);
  note_sent(line, write(modbus_get_socket(line->context), frame, bytes));
}

/* Its commit has been evaluated. */
static void on_evaluated(struct modbus_client *client) {
  struct modbus_line *line = (struct modbus_line *)(void *)client;
  line->waiting = false;
  if (line->context != NULL) {
    answer_by_codec(line, line->bank, 0);
  }
  line->bytes = 0;
}

/* A broadcast is carried out, by the codec what is left to it, and not answered. */
static void answer(struct modbus_line *line) {
  const uint8_t *frame = line->input + line->frame_begin;
  const size_t pdu_bytes = line->frame_end - line->frame_begin - 3;
  struct modbus_answer answer;
  if (is_broadcast(line) && !modbus_pdu_writes(frame[1])) {
    return;
  }
  modbus_answer(line->service, &line->client, line->unit, frame + 1, pdu_bytes, &answer);
  if (answer.later) {
    line->waiting = true;
    line->bank = answer.bank;
  } else if (answer.bytes > 0) {
    answer_by_hand(line, &answer);
  } else if (!is_broadcast(line) || answer.exception == 0) {
    answer_by_codec(line, answer.bank, answer.exception);
  }
}

/* ---- reading ----------------------------------------------------------------------------------
 */

/* Whether what has arrived could be answered if nothing more came. */
static bool is_whole(const struct modbus_line *line) {
  size_t begin;
  return modbus_rtu_find(line->input, line->bytes, line->unit, &begin) > 0;
}

/* What has arrived is a request, or nothing. */
static void on_silence(uv_timer_t *timer) {
  struct modbus_line *line = timer->data;
  if (line->context == NULL) {
    return;
  }
  size_t begin;
  const size_t bytes = modbus_rtu_find(line->input, line->bytes, line->unit, &begin);
  const bool noise = begin == line->bytes && line->bytes > 0;
  if (bytes > 0 && line->input[begin + 1] < 0x80) {
    line->frame_begin = (unsigned)begin;
    line->frame_end = (unsigned)(begin + bytes);
    answer(line);
  } else if (noise) {
    stats_add(&line->service->server->stats, STATS_MODBUS_BAD_FRAMES, 1);
  }
  if (!line->waiting) {
    line->bytes = 0;
  }
  worker_stay_awake(line->service->worker); /* timers come before the poll, the batch after it */
}

static void arrived(struct modbus_line *line, size_t bytes) {
  const struct options *options = &line->service->server->options;
  stats_add(&line->service->server->stats, STATS_RECEIVED_BYTES, bytes);
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
  if (line->waiting) {
    return; /* the master speaks before it is answered, which it is in this round */
  }
  if (line->bytes == sizeof line->input) { /* no silence in four frames: noise */
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

/* ---- starting, losing, stopping ----------------------------------------------------------------
 */

static void on_handle_closed(uv_handle_t *handle) {
  struct modbus_line *line = handle->data;
  line->open_handles--;
}

/* Only then the device may be closed: the loop knows it by its number. */
static void on_poll_closed(uv_handle_t *handle) {
  struct modbus_line *line = handle->data;
  close_device(line);
  line->polling = false;
  line->open_handles--;
}

static void close_poll(struct modbus_line *line) {
  if (line->polling && !uv_is_closing((uv_handle_t *)&line->poll)) {
    uv_close((uv_handle_t *)&line->poll, on_poll_closed);
  }
}

static bool start_polling(struct modbus_line *line) {
  uv_loop_t *loop = worker_loop(line->service->worker);
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
  retry_later(line);
}

void modbus_line_start(struct modbus_line *line) {
  uv_timer_init(worker_loop(line->service->worker), &line->timer);
  line->timer.data = line;
  line->started = true;
  line->open_handles++;
  if (!start_polling(line)) {
    lose_device(line, "poll");
  }
}

void modbus_line_stop(struct modbus_line *line) {
  if (line->started && !line->stopping) {
    on_silence(&line->timer); /* a request that has arrived is answered */
    if (line->waiting) {
      modbus_service_bank(line->service, line->unit);
    }
    line->stopping = true;
    uv_close((uv_handle_t *)&line->timer, on_handle_closed);
    close_poll(line);
  }
}

bool modbus_line_has_stopped(const struct modbus_line *line) {
  return line->open_handles == 0;
}

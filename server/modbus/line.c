#include "server/modbus/line.h"

#include <assert.h>
#include <errno.h>
#include <linux/serial.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "server/net/worker.h"
#include "server/observe/log.h"

enum {
  NS_PER_MS = 1000000,
  SILENCE_LEAST_NS = 1750000, /* the least silence, which the standard sets for rates above 19200 */
  RETRY_MS = 500,
  RETRY_FIRST_MS = 250,
  RETRY_MOST_MS = 30000,
  PROBE_MS = 100, /* Adapters return a byte sooner than this, and masters wait longer. */
};

/* ---- the option ------------------------------------------------------------------------------ */

enum {
  UNIT_MOST = 247,
  RTS_DELAY_MOST_MS = 1000,
  URL_BYTES = 512,
};

static bool read_number(const char *text, int least, int most, int *value) {
  *value = atoi(text);
  return *text != '\0' && strspn(text, "0123456789") == strlen(text) && strlen(text) < 8 &&
         *value >= least && *value <= most;
}

/* Each of these reads a part of the option. It returns NULL, or the text of what is wrong. */

static const char *read_path(struct modbus_device *device, const char *text) {
  if (*text == '\0' || strlen(text) >= sizeof device->path) {
    return "the form is rtu:DEVICE[,BAUD[,PARITY[,UNIT]]][,rts=high|low][,rts-delay-ms=N]";
  }
  memcpy(device->path, text, strlen(text) + 1);
  return NULL;
}

static const char *read_baud(struct modbus_device *device, const char *text) {
  static const int rates[] = {1200,  2400,   4800,   9600,   19200, 38400,
                              57600, 115200, 230400, 460800, 921600};
  for (size_t i = 0; i < sizeof rates / sizeof rates[0]; i++) {
    if (read_number(text, rates[i], rates[i], &device->baud)) {
      return NULL;
    }
  }
  return "BAUD is 1200, 2400, 4800, ... 115200, 230400, 460800 or 921600";
}

/* A character has 11 bits unless the option says otherwise: without parity, it has a second stop
 * bit (MODBUS over Serial Line V1.02, 2.5.1). */
static const char *read_parity(struct modbus_device *device, const char *text) {
  const size_t length = strlen(text);
  device->parity = text[0];
  device->stop_bits = length == 2 ? text[1] - '0' : text[0] == 'N' ? 2 : 1;
  return length >= 1 && length <= 2 && strchr("NEO", text[0]) != NULL &&
                 (device->stop_bits == 1 || device->stop_bits == 2)
             ? NULL
             : "PARITY is N, E or O, maybe with the number of stop bits: N1 or E2";
}

/* Reads a part of the option. Parts without a name come in a fixed order; *place counts them. */
static const char *read_part(struct modbus_device *device, const char *text, unsigned *place) {
  int number;
  if (*place > 0 && strncmp(text, "rts=", 4) == 0) {
    device->rts = strcmp(text + 4, "high") == 0  ? MODBUS_RTS_HIGH
                  : strcmp(text + 4, "low") == 0 ? MODBUS_RTS_LOW
                                                 : MODBUS_RTS_UNUSED;
    return device->rts != MODBUS_RTS_UNUSED ? NULL
                                            : "rts is high or low: RTS while the daemon sends";
  }
  if (*place > 0 && strncmp(text, "rts-delay-ms=", 13) == 0) {
    const bool right = read_number(text + 13, 0, RTS_DELAY_MOST_MS, &number);
    device->rts_delay_ms = (unsigned)number;
    return right ? NULL : "rts-delay-ms is 0 to 1000";
  }
  switch ((*place)++) {
  case 0:
    return read_path(device, text);
  case 1:
    return read_baud(device, text);
  case 2:
    return read_parity(device, text);
  case 3: {
    const bool right = read_number(text, 1, UNIT_MOST, &number);
    device->number = (unsigned)number;
    return right ? NULL : "UNIT is 1 to 247";
  }
  default:
    return read_path(device, "");
  }
}

/* Reads the option. If a part is wrong, prints which one to standard error and returns false. */
static bool read_url(struct modbus_device *device, const char *url) {
  char text[URL_BYTES];
  char *rest = text;
  unsigned place = 0;
  *device = (struct modbus_device){.baud = 19200, .parity = 'E', .stop_bits = 1, .number = 1};
  const int length = snprintf(text, sizeof text, "%s", url + strlen("rtu:"));
  const char *wrong = length < (int)sizeof text ? NULL : read_path(device, "");
  while (wrong == NULL && rest != NULL) {
    wrong = read_part(device, strsep(&rest, ","), &place);
  }
  if (wrong == NULL && device->rts_delay_ms > 0 && device->rts == MODBUS_RTS_UNUSED) {
    wrong = "rts-delay-ms needs rts=high or rts=low";
  }
  if (wrong != NULL) {
    fprintf(stderr, "dipoled: --modbus %s: %s\n", url, wrong);
  }
  return wrong == NULL;
}

/* ---- the device ------------------------------------------------------------------------------ */

static int port_fd(const struct modbus_device *device) {
  return modbus_get_socket(device->context);
}

/* Sets RTS to its level while the daemon sends, or to the other level. fd: of the device, or a copy
 * of it. Returns 0 or an errno. */
static int switch_rts(const struct modbus_device *device, int fd, bool sending) {
  const int rts = TIOCM_RTS;
  const bool high = sending == (device->rts == MODBUS_RTS_HIGH);
  return ioctl(fd, high ? TIOCMBIS : TIOCMBIC, &rts) == 0 ? 0 : errno;
}

/* Decides who sets RTS. Returns 0 or an errno. */
static int set_direction(struct modbus_device *device) {
  struct serial_rs485 rs485 = {
      .flags = SER_RS485_ENABLED |
               (device->rts == MODBUS_RTS_HIGH ? SER_RS485_RTS_ON_SEND : SER_RS485_RTS_AFTER_SEND),
      .delay_rts_before_send = device->rts_delay_ms,
      .delay_rts_after_send = device->rts_delay_ms,
  };
  device->rts_by_hand =
      device->rts != MODBUS_RTS_UNUSED && ioctl(port_fd(device), TIOCSRS485, &rs485) != 0;
  return device->rts_by_hand ? switch_rts(device, port_fd(device), false) : 0;
}

/* Closes the device if it is open. */
static void close_port(struct modbus_device *device) {
  if (device->context != NULL) {
    if (device->rts_by_hand) { /* Otherwise RTS would keep other devices from sending. */
      switch_rts(device, port_fd(device), false);
    }
    modbus_close(device->context);
    modbus_free(device->context);
    device->context = NULL;
  }
}

/* Opens the device, and never blocks; libmodbus sets the terminal up. Returns 0 or an errno. */
static int open_port(struct modbus_device *device) {
  device->context =
      modbus_new_rtu(device->path, device->baud, device->parity, 8, device->stop_bits);
  if (device->context == NULL) {
    return errno;
  }
  if (modbus_connect(device->context) != 0) {
    const int error = errno;
    modbus_free(device->context);
    device->context = NULL;
    return error;
  }
  const int error = set_direction(device);
  if (error != 0) {
    close_port(device);
  }
  return error;
}

/* Returns the time that the line needs for some characters. */
static uint64_t duration_ns(const struct modbus_device *device, uint64_t characters) {
  const uint64_t bits = 1 + 8 + (device->parity != 'N') + (uint64_t)device->stop_bits;
  return characters * bits * 1000000000 / (uint64_t)device->baud;
}

/* ---- the line -------------------------------------------------------------------------------- */

static void lose_device(struct modbus_line *line, const char *why);

static struct modbus_line *line_of(struct client *client) {
  return (struct modbus_line *)(void *)client;
}

static struct stats *stats_of(const struct modbus_line *line) {
  return &line->units->server->stats;
}

static uint64_t to_ms_up(uint64_t ns) {
  return (ns + NS_PER_MS - 1) / NS_PER_MS;
}

static bool is_open(const struct modbus_line *line) {
  return line->device.context != NULL;
}

/* ---- sending --------------------------------------------------------------------------------- */

/* Writes the output. Bytes that the device does not take are lost, as they could be on the line. */
static void write_output(struct modbus_line *line, int fd) {
  const size_t count = line->output_end - line->output_begin;
  const ssize_t sent = write(fd, line->output + line->output_begin, count);
  line->output_begin = line->output_end;
  if (sent > 0) {
    stats_add(stats_of(line), STATS_SENT_BYTES, (uint64_t)sent);
  }
  if (sent < 0 || (size_t)sent < count) {
    log_peer_line(LOG_LEVEL_INFO, "event=modbus-reply-lost device=%s reason=%s", line->device.path,
                  sent < 0 ? strerror(errno) : "the device's buffer is full");
  }
}

static void set_rts(const struct modbus_line *line, int fd, bool sending) {
  if (switch_rts(&line->device, fd, sending) != 0) {
    log_peer_line(LOG_LEVEL_ERROR, "event=modbus-rts-failed device=%s reason=%s", line->device.path,
                  strerror(errno));
  }
}

/* Sends with RTS by hand, on a thread of the pool: RTS has to change soon after the last character,
 * because the master may begin 3.5 characters later, and the worker may be at other work for longer. */
static void send_by_hand(uv_work_t *work) {
  struct modbus_line *line = work->data;
  const size_t count = line->output_end - line->output_begin;
  const unsigned delay_us = line->device.rts_delay_ms * 1000;
  set_rts(line, line->sending_fd, true);
  usleep(delay_us);
  write_output(line, line->sending_fd);
  usleep((useconds_t)(duration_ns(&line->device, count) / 1000) + delay_us);
  set_rts(line, line->sending_fd, false);
}

static void end_probe(struct modbus_line *line);
static void await_silence(struct modbus_line *line);
static void note_closed(struct modbus_line *line);

static void on_sent(uv_work_t *work, int status) {
  struct modbus_line *line = work->data;
  (void)status;
  close(line->sending_fd);
  line->sending = false;
  if (line->probing && line->receiver.count > 0) {
    end_probe(line);
    await_silence(line);
  } else if (line->stopping || !uv_is_active((uv_handle_t *)&line->timer)) {
    worker_run_later(&line->client); /* Its turn reads what has arrived, as no timer will. */
  }
  note_closed(line);
}

/* Sends the output up to `end`. */
static void send_up_to(struct modbus_line *line, size_t end) {
  const struct modbus_device *device = &line->device;
  const int fd = port_fd(device);
  const uint64_t delay_ns = device->rts_by_hand ? device->rts_delay_ms * UINT64_C(1000000) : 0;
  assert(!line->sending && line->output_begin < end);
  line->output_end = end;
  line->sent_ns = uv_hrtime() + duration_ns(device, end - line->output_begin) + 2 * delay_ns;
  if (!device->rts_by_hand) {
    write_output(line, fd);
    return;
  }
  line->sending_fd = dup(fd); /* a copy, because the device may be closed meanwhile */
  line->sending = true;
  line->open_handles++;
  line->work.data = line;
  uv_queue_work(&line->client.worker->loop, &line->work, send_by_hand, on_sent);
}

/* Returns for how long the line still sends the last reply, by its speed. */
static uint64_t sending_ns(const struct modbus_line *line) {
  const uint64_t now_ns = uv_hrtime();
  return is_open(line) && line->sent_ns > now_ns ? line->sent_ns - now_ns : 0;
}

static void on_probe_over(uv_timer_t *timer);

/* Sends the reply whose PDU begins at output[1]. */
static void send_reply(struct modbus_line *line, size_t pdu_bytes) {
  uint8_t *frame = line->output;
  frame[0] = (uint8_t)line->device.number;
  const uint16_t sum = modbus_rtu_checksum(frame, 1 + pdu_bytes);
  frame[1 + pdu_bytes] = (uint8_t)sum;
  frame[2 + pdu_bytes] = (uint8_t)(sum >> 8);
  if (!is_open(line)) {
    return;
  }
  line->output_begin = 0;
  line->frame_bytes = 3 + pdu_bytes;
  line->probing = modbus_receiver_sent(&line->receiver, frame, line->frame_bytes);
  send_up_to(line, line->probing ? 1 : line->frame_bytes);
  if (line->probing) {
    const uint64_t left_ms = to_ms_up(sending_ns(line));
    uv_timer_start(&line->timer, on_probe_over, left_ms + PROBE_MS, 0);
  }
}

/* Ends a probe: called when bytes have arrived after the first byte of the reply, or when its echo
 * would have arrived. Sends the rest of the reply. */
static void end_probe(struct modbus_line *line) {
  line->probing = false;
  modbus_receiver_probed(&line->receiver);
  if (is_open(line)) {
    send_up_to(line, line->frame_bytes);
  }
}

/* ---- serving ------------------------------------------------------------------------------- */

static size_t request_pdu_bytes(const struct modbus_line *line) {
  return line->burst.bytes - 3;
}

/* Sends the reply whose PDU begins at output[1], unless the request is a broadcast. */
static void finish_request(struct modbus_line *line, size_t pdu_bytes) {
  if (line->burst.request[0] != MODBUS_BROADCAST_ADDRESS) {
    send_reply(line, pdu_bytes);
  }
}

/* Carries out the request of the last burst. */
static void handle_request(struct modbus_line *line) {
  struct modbus_unit *unit = NULL;
  const uint8_t *pdu = line->burst.request + 1;
  if (line->burst.request[0] == MODBUS_BROADCAST_ADDRESS &&
      (modbus_pdu_roles(pdu[0]) & ROLE_WRITE) == 0) {
    return;
  }
  const size_t replied_bytes =
      modbus_carry_out(line->units, &line->client, ROLE_ALL, line->device.number, pdu,
                       request_pdu_bytes(line), line->output + 1, &unit);
  if (replied_bytes > 0) {
    modbus_log_refusal(pdu, request_pdu_bytes(line), line->output + 1, line->burst.request[0],
                       "device", line->device.path);
    finish_request(line, replied_bytes);
  } else {
    line->waits_for = unit;
  }
}

/* Serves the request whose commit has been evaluated. */
static void reply_late(struct modbus_line *line) {
  const size_t replied_bytes = modbus_late_reply(line->waits_for, line->burst.request + 1,
                                                 request_pdu_bytes(line), line->output + 1);
  line->waits_for = NULL;
  finish_request(line, replied_bytes);
}

static void note_burst(struct modbus_line *line) {
  const struct modbus_burst *burst = &line->burst;
  stats_add(stats_of(line), STATS_MODBUS_BAD_FRAMES, burst->bad);
  if (burst->echoed && !line->echo_is_logged) {
    line->echo_is_logged = true;
    log_line(LOG_LEVEL_INFO, "event=modbus-echo device=%s", line->device.path);
  }
}

/* Called after a silence: serves a request in the bytes that have arrived. */
static void run_turn(struct client *client) {
  struct modbus_line *line = line_of(client);
  if (!is_open(line) || line->waits_for != NULL || line->probing || line->sending) {
    return;
  }
  modbus_receiver_end(&line->receiver, &line->burst);
  note_burst(line);
  if (line->burst.bytes > 0) {
    handle_request(line);
  }
}

/* ---- reading --------------------------------------------------------------------------------- */

static void on_silence(uv_timer_t *timer);

static void await_silence(struct modbus_line *line) {
  const uint64_t wait_ms = modbus_receiver_is_whole(&line->receiver)
                               ? to_ms_up(line->receiver.silence_ns)
                               : line->units->server->options.modbus_gap_ms;
  uv_timer_start(&line->timer, on_silence, wait_ms, 0);
}

static void note_arrival(struct modbus_line *line, size_t bytes) {
  stats_add(stats_of(line), STATS_RECEIVED_BYTES, bytes);
  modbus_receiver_arrived(&line->receiver, bytes, uv_hrtime());
  line->retry_ms = RETRY_FIRST_MS;
  if (line->probing && line->sending) {
    return; /* When sending ends, the probe ends too. */
  }
  if (line->probing) {
    end_probe(line);
  }
  await_silence(line);
}

static void read_more(struct modbus_line *line) {
  size_t room;
  uint8_t *bytes = modbus_receiver_room(&line->receiver, &room);
  const ssize_t got = read(port_fd(&line->device), bytes, room);
  if (got > 0) {
    note_arrival(line, (size_t)got);
  } else if (got == 0) {
    lose_device(line, "end-of-file");
  } else if (errno != EAGAIN && errno != EINTR) {
    lose_device(line, strerror(errno));
  }
}

/* Reads bytes that arrived before a timer fired, but that a busy worker has not read yet. Returns
 * false if there are none. */
static bool read_unseen(struct modbus_line *line) {
  int waiting = 0;
  if (!is_open(line) || ioctl(port_fd(&line->device), FIONREAD, &waiting) != 0 || waiting == 0) {
    return false;
  }
  read_more(line);
  return true;
}

static void on_silence(uv_timer_t *timer) {
  struct modbus_line *line = timer->data;
  if (line->stopping || !read_unseen(line)) {
    worker_run_later(&line->client);
  }
}

static void on_probe_over(uv_timer_t *timer) {
  struct modbus_line *line = timer->data;
  if (line->sending) {
    uv_timer_start(&line->timer, on_probe_over, PROBE_MS, 0);
  } else if (!read_unseen(line)) {
    end_probe(line);
    worker_run_later(&line->client); /* If the daemon stops, this line has waited for the probe. */
  }
}

static void on_poll(uv_poll_t *poll, int status, int events) {
  (void)events;
  struct modbus_line *line = poll->data;
  if (status < 0) {
    lose_device(line, uv_strerror(status));
    /* A line in the run queue reads these bytes in its turn. */
  } else if (line->client.run_queue == NULL) {
    read_more(line);
  }
}

/* ---- opening --------------------------------------------------------------------------------- */

static void log_open(struct modbus_line *line) {
  const struct modbus_device *device = &line->device;
  if (line->was_open) {
    log_line(LOG_LEVEL_INFO, "event=modbus-device-back device=%s", device->path);
    return;
  }
  line->was_open = true;
  log_line(LOG_LEVEL_INFO, "event=listening url=modbus-rtu:%s,%d,%c,%u stop_bits=%d rts=%s",
           device->path, device->baud, device->parity, device->number, device->stop_bits,
           device->rts == MODBUS_RTS_UNUSED ? "unused"
           : device->rts_by_hand            ? "by-hand"
                                            : "by-driver");
}

/* Tries to open the device. Logs why it cannot be opened, unless the last attempt failed alike. */
static bool open_device(struct modbus_line *line) {
  const int error = open_port(&line->device);
  if (error == 0) {
    log_open(line);
  } else if (error != line->open_error) {
    log_line(LOG_LEVEL_ERROR, "event=modbus-device-missing device=%s reason=%s", line->device.path,
             modbus_strerror(error));
  }
  line->open_error = error;
  return error == 0;
}

/* Starts anew with a device that has been opened. */
static void reset_line(struct modbus_line *line) {
  modbus_receiver_reset(&line->receiver);
  line->probing = false;
  line->echo_is_logged = false;
}

/* ---- starting, losing, stopping -------------------------------------------------------------- */

static void note_closed(struct modbus_line *line) {
  assert(line->open_handles > 0);
  if (--line->open_handles == 0) {
    worker_forget(&line->client);
    modbus_units_leave(line->units, &line->client);
  }
}

static void on_handle_closed(uv_handle_t *handle) {
  note_closed(handle->data);
}

/* Closes the device after its poll: the loop knows the device by its descriptor until then. */
static void on_poll_closed(uv_handle_t *handle) {
  struct modbus_line *line = handle->data;
  close_port(&line->device);
  line->polling = false;
  note_closed(line);
}

static void close_poll(struct modbus_line *line) {
  if (line->polling && !uv_is_closing((uv_handle_t *)&line->poll)) {
    uv_close((uv_handle_t *)&line->poll, on_poll_closed);
  }
}

static bool start_polling(struct modbus_line *line) {
  uv_loop_t *loop = &line->client.worker->loop;
  if (uv_poll_init(loop, &line->poll, port_fd(&line->device)) != 0) {
    close_port(&line->device);
    return false;
  }
  line->poll.data = line;
  line->polling = true;
  line->open_handles++;
  reset_line(line);
  return uv_poll_start(&line->poll, UV_READABLE, on_poll) == 0;
}

static void on_retry(uv_timer_t *timer) {
  struct modbus_line *line = timer->data;
  if (line->polling || !open_device(line) || !start_polling(line)) {
    line->retry_ms = RETRY_MS;
    uv_timer_start(&line->timer, on_retry, RETRY_MS, 0);
  }
}

static void lose_device(struct modbus_line *line, const char *why) {
  log_peer_line(LOG_LEVEL_ERROR, "event=modbus-device-lost device=%s reason=%s", line->device.path,
                why);
  line->sent_ns = 0;
  line->probing = false;
  close_poll(line);
  if (line->stopping) {
    worker_run_later(&line->client);
    return;
  }
  uv_timer_start(&line->timer, on_retry, line->retry_ms, 0);
  line->retry_ms = line->retry_ms * 2 < RETRY_MOST_MS ? line->retry_ms * 2 : RETRY_MOST_MS;
}

static void start_client(struct client *client) {
  struct modbus_line *line = line_of(client);
  line->units->users++;
  uv_timer_init(&client->worker->loop, &line->timer);
  line->timer.data = line;
  line->open_handles = 1;
  if (!is_open(line)) {
    uv_timer_start(&line->timer, on_retry, RETRY_MS, 0);
  } else if (!start_polling(line)) {
    lose_device(line, "poll");
  }
}

/* Called after a turn, and when the unit for which the line waits has its results. */
static void finish_turn(struct client *client) {
  struct modbus_line *line = line_of(client);
  if (line->waits_for != NULL) {
    if (line->waits_for->awaited != NULL) {
      return;
    }
    reply_late(line);
  }
  if (!line->stopping || line->probing || uv_is_closing((uv_handle_t *)&line->timer)) {
    return;
  }
  const uint64_t left_ns = sending_ns(line);
  if (left_ns > 0) { /* Closing now would cut the reply off. */
    uv_timer_start(&line->timer, on_silence, to_ms_up(left_ns), 0);
  } else if (!line->sending) {
    uv_close((uv_handle_t *)&line->timer, on_handle_closed);
    close_poll(line);
  }
}

/* Stops the line. A request that has been sent is still served, after a silence, because a device
 * may deliver its bytes late. */
static void stop_client(struct client *client) {
  struct modbus_line *line = line_of(client);
  if (!line->stopping) {
    line->stopping = true;
    if (!line->probing) {
      uv_timer_start(&line->timer, on_silence, line->units->server->options.modbus_gap_ms, 0);
    }
  }
}

static void abort_line(struct client *client) {
  struct modbus_line *line = line_of(client);
  line->stopping = true;
  line->sent_ns = 0;
  line->probing = false;
  worker_run_later(client);
}

bool modbus_line_open(struct modbus_line *line, struct modbus_units *units, const char *url) {
  static const struct client_kind kind = {
      .start = start_client,
      .run = run_turn,
      .finish = finish_turn,
      .stop = stop_client,
      .abort = abort_line,
  };
  *line = (struct modbus_line){
      .client.kind = &kind,
      .units = units,
      .retry_ms = RETRY_FIRST_MS,
  };
  if (!read_url(&line->device, url)) {
    return false;
  }
  const uint64_t silence_ns = duration_ns(&line->device, 7) / 2;
  line->receiver.number = line->device.number;
  line->receiver.silence_ns = silence_ns > SILENCE_LEAST_NS ? silence_ns : SILENCE_LEAST_NS;
  open_device(line);
  return true;
}

void modbus_line_close(struct modbus_line *line) {
  close_port(&line->device);
}

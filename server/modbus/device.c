#include "server/modbus/device.h"

#include <errno.h>
#include <linux/serial.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>

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

bool modbus_device_read_url(struct modbus_device *device, const char *url) {
  char text[URL_BYTES];
  char *rest = text;
  const char *wrong = NULL;
  unsigned place = 0;
  *device = (struct modbus_device){.baud = 19200, .parity = 'E', .stop_bits = 1, .number = 1};
  const int length = snprintf(text, sizeof text, "%s", url + strlen("rtu:"));
  if (length < 0 || (size_t)length >= sizeof text) {
    wrong = read_path(device, "");
  }
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

int modbus_device_fd(const struct modbus_device *device) {
  return modbus_get_socket(device->context);
}

int modbus_device_set_rts(const struct modbus_device *device, int fd, bool sending) {
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
      device->rts != MODBUS_RTS_UNUSED && ioctl(modbus_device_fd(device), TIOCSRS485, &rs485) != 0;
  return device->rts_by_hand ? modbus_device_set_rts(device, modbus_device_fd(device), false) : 0;
}

int modbus_device_open(struct modbus_device *device) {
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
    modbus_device_close(device);
  }
  return error;
}

void modbus_device_close(struct modbus_device *device) {
  if (device->context != NULL) {
    if (device->rts_by_hand) { /* Otherwise RTS would keep other devices from sending. */
      modbus_device_set_rts(device, modbus_device_fd(device), false);
    }
    modbus_close(device->context);
    modbus_free(device->context);
    device->context = NULL;
  }
}

uint64_t modbus_device_duration_ns(const struct modbus_device *device, uint64_t characters) {
  const uint64_t bits = 1 + 8 + (device->parity != 'N') + (uint64_t)device->stop_bits;
  return characters * bits * 1000000000 / (uint64_t)device->baud;
}

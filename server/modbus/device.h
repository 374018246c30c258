/* device: reads the settings of a serial line from an option, and opens its device. libmodbus sets
 * the terminal up. RTS can control the direction of an RS-485 adapter. The device's driver sets RTS
 * if it can; otherwise the caller does, by modbus_device_set_rts().
 */
#ifndef DIPOLED_MODBUS_DEVICE_H
#define DIPOLED_MODBUS_DEVICE_H

#include <modbus.h>
#include <stdbool.h>
#include <stdint.h>

enum { MODBUS_DEVICE_PATH_BYTES = 256 };

/* The level of RTS while the daemon sends. */
enum modbus_rts { MODBUS_RTS_UNUSED, MODBUS_RTS_HIGH, MODBUS_RTS_LOW };

struct modbus_device {
  char path[MODBUS_DEVICE_PATH_BYTES];
  int baud;
  char parity; /* 'N', 'E' or 'O' */
  int stop_bits;
  unsigned number; /* number of the unit on this line */
  enum modbus_rts rts;
  /* Delay between RTS and the first character, and between the last character and RTS. */
  unsigned rts_delay_ms;

  modbus_t *context; /* context of libmodbus; NULL while the device is closed */
  bool rts_by_hand;  /* whether the caller has to set RTS */
};

/* Reads rtu:DEVICE[,BAUD[,PARITY[,UNIT]]][,rts=high|low][,rts-delay-ms=N]. The device need not
 * exist. If a part is wrong, prints which one to standard error and returns false. */
bool modbus_device_read_url(struct modbus_device *device, const char *url);

/* Opens the device, and never blocks. Returns 0 or an errno; modbus_strerror() has its text. */
int modbus_device_open(struct modbus_device *device);

/* Closes the device if it is open. */
void modbus_device_close(struct modbus_device *device);

/* Returns the file descriptor of the open device. */
int modbus_device_fd(const struct modbus_device *device);

/* Sets RTS to its level while the daemon sends, or to the other level. fd: of the device, or a copy of
 * it. Returns 0 or an errno. */
int modbus_device_set_rts(const struct modbus_device *device, int fd, bool sending);

/* Returns the time that the line needs for some characters. */
uint64_t modbus_device_duration_ns(const struct modbus_device *device, uint64_t characters);

#endif

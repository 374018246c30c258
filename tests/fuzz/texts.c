/* The targets for texts: `csv`, files of `dipole points`, and `texts`, options of the daemon. */
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "clients/c/address.h"
#include "clients/cli/csv.h"
#include "proto/decimal.h"
#include "server/net/access.h"
#include "server/options.h"
#include "tests/fuzz/fuzz.h"

static FILE *nowhere;
static int file;

/* Discards what the command line writes to standard error. */
void fuzz_csv_start(void) {
  nowhere = fopen("/dev/null", "w");
  file = memfd_create("fuzz", MFD_CLOEXEC);
  CHECK(nowhere != NULL && file >= 0);
  stderr = nowhere;
}

/* The target for files of readings and points. The bytes that are read are all bytes of the file, in
 * their order. */
void fuzz_csv(const uint8_t *data, size_t size) {
  static cli_csv_reader reader;
  cli_csv_record record = {0};
  CHECK(ftruncate(file, 0) == 0 && pwrite(file, data, size, 0) == (ssize_t)size &&
        lseek(file, 0, SEEK_SET) == 0);
  reader = (cli_csv_reader){.fd = file};
  size_t done = 0;
  enum cli_csv_kind kind;
  while ((kind = cli_csv_read(&reader, &record)) == CLI_CSV_RECORD || kind == CLI_CSV_COMMENT) {
    CHECK(record.length > 0);
    CHECK(record.length <= size - done && memcmp(record.bytes, data + done, record.length) == 0);
    done += record.length;
    for (size_t i = 0; kind == CLI_CSV_RECORD && i < record.cell_count; i++) {
      size_t length;
      double value;
      CHECK(record.cells[i].begin <= record.cells[i].end && record.cells[i].end <= record.length);
      const char *text = cli_csv_cell_text(&record, i, &length);
      CHECK(text[length] == '\0');
      cli_csv_number(&record, i, &value);
      cli_csv_copy_cell(&record, i, nowhere);
      cli_csv_write_cell(text, nowhere);
    }
    cli_csv_record_free(&record);
  }
  CHECK(kind != CLI_CSV_END || done == size);
  cli_csv_record_free(&record);
}

/* The target for options of the daemon, one behind each zero byte. Each is also read as an address,
 * a network and a number. */
void fuzz_texts(const uint8_t *data, size_t size) {
  enum { WORDS = 40 };
  char *words[WORDS + 2] = {"dipoled"};
  int count = 1;
  char *copy = malloc(size + 1);
  memcpy(copy, data, size);
  copy[size] = '\0';
  for (size_t at = 0; at < size && count <= WORDS; at += strlen(copy + at) + 1) {
    char *word = words[count++] = copy + at;
    libdipole_addresses addresses;
    libdipole_address address;
    dipole_error error = {0};
    if (libdipole_addresses_parse(word, &addresses, &error)) {
      CHECK(addresses.count > 0 && addresses.count <= DIPOLE_ADDRESSES_MAX);
      for (size_t i = 0; i < addresses.count; i++) {
        libdipole_address_parse(addresses.texts[i], &address, &error);
      }
    } else {
      CHECK(error.text[0] != '\0');
    }
    libdipole_addresses_free(&addresses);
    const struct options_list list = {.items = {word}, .count = 1};
    struct access access;
    const char *wrong;
    if (access_read(&list, &access_this_machine, &access, &wrong)) {
      CHECK(access.count == 1 && access.networks[0].bits <= 128);
    }
    double value, again;
    char text[DECIMAL_BYTES];
    if (decimal_read(word, &value)) {
      decimal_write(value, text);
      CHECK(decimal_read(text, &again));
      CHECK(again == value || value != value);
    }
  }
  struct options options;
  optind = 0; /* so that getopt_long() starts anew */
  options_read(count, words, &options);
  options_free(&options);
  free(copy);
}

void fuzz_texts_start(void) {
  fuzz_csv_start();
  stdout = nowhere;
}

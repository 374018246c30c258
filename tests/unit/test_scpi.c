/* The text of SCPI: messages that arrive in pieces, units, headers. */
#include <string.h>

#include "server/scpi/parse.h"
#include "tests/unit/unit.h"

/* Blocks hide newlines and semicolons, strings semicolons alone. */
UNIT_TEST(messages_end_at_the_same_byte_however_they_arrive) {
  static const char stream[] =
      "A #15\n;\n\n\n,2;B\nC 'a;b',\"#19\"\r\n#15 a\nD #0,#9999999999;\nE 'x\n";
  static const size_t ends[] = {15, 30, 36, 54, 59};
  for (size_t piece = 1; piece <= sizeof stream; piece++) {
    struct scpi_scan scan = {0};
    size_t begin = 0, found = 0;
    for (size_t count = 0; count < sizeof stream - 1;) {
      count = count + piece < sizeof stream - 1 ? count + piece : sizeof stream - 1;
      while (scpi_scan(&scan, stream + begin, count - begin, '\n')) {
        begin += scan.at;
        scan = (struct scpi_scan){0};
        assert_int_equal(begin, ends[found++]);
      }
    }
    assert_int_equal(found, sizeof ends / sizeof ends[0]);
  }
}

UNIT_TEST(headers_in_long_and_short_form) {
  static const struct {
    const char *pattern, *header;
    unsigned number; /* 0: it does not fit */
  } cases[] = {{"MEDium:LAYer<n>", "med:lay12", 12},
               {"MEDium:LAYer<n>", "MEDIUM:LAYER", 1},
               {"MEDium:LAYer<n>", "MED:LAYE1", 0},
               {"MEDium:LAYer<n>", "MED:LAY1:X", 0},
               {"SYSTem:ERRor[:NEXT]", "SYST:ERR", 1},
               {"SYSTem:ERRor[:NEXT]", "SYST:ERR:NEXT", 1},
               {"SYSTem:ERRor[:NEXT]", "SYST:ERR:", 0},
               {"SYSTem:ERRor[:NEXT]", "SYST", 0},
               {"*IDN", "*idn", 1},
               {"*IDN", "*IDNN", 0},
               {"R", "", 0},
               {"R", "r1", 0}};
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    unsigned number = 1;
    const char *header = cases[i].header;
    const bool fits = scpi_matches(cases[i].pattern, header, strlen(header), &number);
    assert_int_equal(fits ? number : 0, cases[i].number);
  }
}

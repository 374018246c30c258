#include "core/tools/tradeoff/picture.h"

#include <errno.h>
#include <string.h>

#include "core/tools/figures/fail.h"
#include "core/tools/figures/gnuplot.h"

enum { PATH_BYTES = 4096 };

static const struct {
  const char *ending;
  const char *terminal;
} forms[] = {
    {".svg", "svg size %u,%u dynamic background rgb 'white' font 'sans,12' noenhanced"},
    {".png", "pngcairo size %u,%u background rgb 'white' font 'sans,11' noenhanced"},
};

void picture_draw(const char *path, unsigned width, unsigned height,
                  void (*put)(FILE *script, const void *context), const void *context) {
  for (size_t i = 0; i < sizeof forms / sizeof forms[0]; i++) {
    char name[PATH_BYTES];
    if (snprintf(name, sizeof name, "%s%s", path, forms[i].ending) >= PATH_BYTES) {
      fail("%s: the name is too long", path);
    }
    FILE *script = tmpfile();
    if (script == NULL) {
      fail("cannot make a temporary file: %s", strerror(errno));
    }
    fputs("set encoding utf8\nset terminal ", script);
    fprintf(script, forms[i].terminal, width, height);
    fputc('\n', script);
    put(script, context);
    gnuplot_draw(script, name);
  }
}

#include "clients/cli/image.h"

#include <errno.h>
#include <math.h>
#include <png.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/cli.h"

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "PFM is written little-endian");

static bool fail(const char *file, const char *what) {
  cli_fail("%s: %s", file, what);
  return false;
}

/* Allocates the values of an image of this size, if it is one that is supported. */
static bool allocate(const char *file, size_t width, size_t height, size_t channels,
                     cli_image *image) {
  if (width < 1 || height < 1 || width > CLI_IMAGE_SIDE_MAX || height > CLI_IMAGE_SIDE_MAX) {
    return fail(file, "its width and height are not from 1 to 65536");
  }
  const uint64_t bytes = (uint64_t)width * height * channels * sizeof *image->values;
  *image = (cli_image){width, height, channels, NULL};
  image->values = bytes <= SIZE_MAX ? malloc((size_t)bytes) : NULL;
  return image->values != NULL || fail(file, "there is no memory for an image of its size");
}

/* ---- PNG ------------------------------------------------------------------------------------- */

static void on_png_error(png_structp png, png_const_charp what) {
  fail(png_get_error_ptr(png), what);
  png_longjmp(png, 1);
}

/* Says why a colour profile is not used; libpng then leaves it out. */
static void on_png_warning(png_structp png, png_const_charp what) {
  if (strncmp(what, "iCCP", 4) == 0 && strstr(what, "known incorrect sRGB") == NULL) {
    cli_say(CLI_OK, "%s: its colour profile is not used: %s", (const char *)png_get_error_ptr(png),
            what);
  }
}

/* How shares of the largest value become linear light. */
typedef struct curve {
  enum { SRGB, POWER, PROFILE } kind;
  double exponent;
  const uint8_t *profile; /* a curve of an ICC profile (ICC.1:2022): "curv" or "para" */
} curve;

static uint32_t number_at(const uint8_t *at) {
  return (uint32_t)at[0] << 24 | (uint32_t)at[1] << 16 | (uint32_t)at[2] << 8 | at[3];
}

/* Evaluates a curve that is_whole(). */
static double profile_decode(const uint8_t *of, double share) {
  if (of[0] == 'c') {
    const uint32_t count = number_at(of + 8);
    const double place = share * (count - 1.0), low = fmin(floor(place), count - 2.0);
    const uint8_t *at = of + 12 + (count > 1 ? 2 * (size_t)low : 0);
    return count == 0   ? share
           : count == 1 ? pow(share, at[0] + at[1] / 256.0)
                        : ((at[0] * 256 + at[1]) * (low + 1 - place) +
                           (at[2] * 256 + at[3]) * (place - low)) /
                              65535;
  }
  double g[7] = {0};
  static const uint8_t counts[] = {1, 3, 4, 5, 7};
  for (size_t i = 0; i < counts[of[9]]; i++) {
    g[i] = (int32_t)number_at(of + 12 + 4 * i) / 65536.0;
  }
  if (of[9] == 0) {
    return pow(share, g[0]);
  }
  if (of[9] <= 2) { /* 0, or a constant, below -b / a */
    return (g[1] * share + g[2] > 0 ? pow(g[1] * share + g[2], g[0]) : 0) + g[3];
  }
  return share >= g[4] ? pow(fmax(g[1] * share + g[2], 0), g[0]) + g[5] : g[3] * share + g[6];
}

static double decode(double share, const curve *by) {
  switch (by->kind) {
  case POWER:
    return by->exponent == 1 ? share : pow(share, by->exponent);
  case PROFILE:
    return profile_decode(by->profile, share);
  case SRGB:
    break;
  }
  return share <= 0.04045 ? share / 12.92 : pow((share + 0.055) / 1.055, 2.4); /* IEC 61966-2-1 */
}

static bool is_whole(const uint8_t *of, size_t bytes) {
  static const uint8_t para_bytes[] = {16, 24, 28, 32, 40};
  return bytes >= 12 && ((memcmp(of, "curv", 4) == 0 && number_at(of + 8) <= (bytes - 12) / 2) ||
                         (memcmp(of, "para", 4) == 0 && of[8] == 0 && of[9] < sizeof para_bytes &&
                          bytes >= para_bytes[of[9]]));
}

/* Finds the curve that a profile has for all of its channels. */
static bool find_profile_curve(const uint8_t *profile, size_t bytes, curve *found) {
  enum { TAGS = 128, TAG_BYTES = 12 };
  size_t found_bytes = 0;
  const size_t count = bytes >= TAGS + 4 ? number_at(profile + TAGS) : 0;
  for (size_t i = 0; i < count && TAGS + 4 + (i + 1) * TAG_BYTES <= bytes; i++) {
    const uint8_t *tag = profile + TAGS + 4 + i * TAG_BYTES;
    const size_t at = number_at(tag + 4), length = number_at(tag + 8);
    if (memcmp(tag + 1, "TRC", 3) != 0) {
      continue;
    }
    if (at > bytes || length > bytes - at || !is_whole(profile + at, length) ||
        (found_bytes > 0 &&
         (length != found_bytes || memcmp(profile + at, found->profile, found_bytes) != 0))) {
      return false;
    }
    *found = (curve){.kind = PROFILE, .profile = profile + at};
    found_bytes = length;
  }
  return found_bytes > 0;
}

/* Finds out how a file says that its values become linear light: cICP goes first, then sRGB, iCCP
 * and gAMA (Portable Network Graphics, third edition). Without a word they are sRGB, and so they
 * are where gAMA is nearly 1 / 2.2, which files that are sRGB say. */
static bool find_curve(png_structp png, png_infop info, const char *file, curve *found) {
  enum { CICP_POWER_22 = 4, CICP_POWER_28 = 5, CICP_LINEAR = 8, CICP_SRGB = 13 };
  png_unknown_chunkp chunks = NULL;
  png_charp name;
  png_bytep profile;
  png_uint_32 bytes;
  int method;
  double gamma;
  const int count = png_get_unknown_chunks(png, info, &chunks);
  for (int i = 0; i < count; i++) {
    if (memcmp(chunks[i].name, "cICP", 4) == 0 && chunks[i].size == 4) {
      const unsigned transfer = chunks[i].data[1];
      *found = transfer == CICP_SRGB ? (curve){.kind = SRGB} : (curve){POWER, 1, NULL};
      found->exponent = transfer == CICP_POWER_22 ? 2.2 : transfer == CICP_POWER_28 ? 2.8 : 1;
      return transfer == CICP_SRGB || transfer == CICP_LINEAR || found->exponent > 1 ||
             fail(file, "its cICP chunk names a transfer function that is not known here: convert "
                        "it to sRGB, or add --linear if its values are linear");
    }
  }
  *found = (curve){.kind = SRGB};
  if (png_get_valid(png, info, PNG_INFO_sRGB) != 0) {
    return true;
  }
  if (png_get_iCCP(png, info, &name, &method, &profile, &bytes) != 0) {
    return find_profile_curve(profile, bytes, found) ||
           fail(file, "its colour profile has no curve for all channels: convert it to sRGB, or "
                      "add --linear if its values are linear");
  }
  if (png_get_gAMA(png, info, &gamma) != 0 && gamma > 0 && fabs(gamma * 2.2 - 1) > 0.01) {
    *found = (curve){.kind = POWER, .exponent = 1 / gamma};
  }
  return true;
}

/* Computes the values of one row. table: [256] for 8 bits. Returns how many pixels are opaque. */
static size_t take_row(const uint8_t *row, unsigned bits, size_t samples, const float table[256],
                       const curve *by, const cli_image *image, float *values) {
  const size_t bytes = bits / 8;
  size_t opaque = 0;
  for (size_t x = 0; x < image->width; x++, row += samples * bytes) {
    for (size_t c = 0; c < image->channels; c++) {
      const uint8_t *at = row + c * bytes;
      *values++ = bits == 8 ? table[*at] : (float)decode((at[0] * 256 + at[1]) / 65535.0, by);
    }
    const uint8_t *last = row + samples * bytes - bytes;
    opaque += samples == image->channels || (last[0] == 255 && last[bytes - 1] == 255);
  }
  return opaque;
}

/* Deflate makes data at most so many times smaller. */
enum { DEFLATE_RATIO_MAX = 1032 };

/* Reads the header and makes libpng give 8 or 16 bits of 1 or 3 channels, and maybe an opacity. */
static bool start_png(png_structp png, png_infop info, const char *file, size_t file_bytes,
                      cli_image *image) {
  png_set_keep_unknown_chunks(png, PNG_HANDLE_CHUNK_ALWAYS, (png_const_bytep) "cICP", 1);
  png_read_info(png, info);
  const unsigned type = png_get_color_type(png, info);
  if (png_get_image_height(png, info) / DEFLATE_RATIO_MAX * png_get_rowbytes(png, info) >
      file_bytes) {
    return fail(file, "the PNG ends too early");
  }
  png_set_expand(png); /* palettes become colours, and few bits become 8 */
  const int passes = png_set_interlace_handling(png);
  png_read_update_info(png, info);
  (void)passes;
  return allocate(file, png_get_image_width(png, info), png_get_image_height(png, info),
                  (type & PNG_COLOR_MASK_COLOR) != 0 ? 3 : 1, image);
}

/* What is freed also if libpng gives up halfway. */
struct png_reading {
  uint8_t *bytes;
  uint8_t **rows;
};

static bool read_png_rows(png_structp png, png_infop info, const char *file, size_t file_bytes,
                          bool linear, struct png_reading *reading, cli_image *image) {
  float table[256];
  curve by = {.kind = POWER, .exponent = 1};
  if (!start_png(png, info, file, file_bytes, image) ||
      (!linear && !find_curve(png, info, file, &by))) {
    return false;
  }
  const size_t row_bytes = png_get_rowbytes(png, info);
  reading->bytes = malloc(row_bytes * image->height);
  reading->rows = calloc(image->height, sizeof *reading->rows);
  if (reading->bytes == NULL || reading->rows == NULL) {
    return fail(file, "there is no memory for an image of its size");
  }
  for (size_t y = 0; y < image->height; y++) {
    reading->rows[y] = reading->bytes + y * row_bytes;
  }
  png_read_image(png, reading->rows);
  png_read_end(png, NULL);
  for (unsigned i = 0; i < 256; i++) {
    table[i] = (float)decode(i / 255.0, &by);
  }
  const size_t pixels = image->width * image->height;
  size_t opaque = 0;
  for (size_t y = 0; y < image->height; y++) {
    opaque += take_row(reading->rows[y], png_get_bit_depth(png, info), png_get_channels(png, info),
                       table, &by, image, image->values + y * image->width * image->channels);
  }
  if (opaque < pixels) {
    cli_say(CLI_OK, "%s: %zu of %zu pixels are not opaque; their opacity (alpha) is left out", file,
            pixels - opaque, pixels);
  }
  return true;
}

static bool read_png(const char *file, FILE *from, size_t file_bytes, bool linear,
                     cli_image *image) {
  struct png_reading *reading = cli_allocate(1, sizeof *reading);
  png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, (png_voidp)(uintptr_t)file,
                                           on_png_error, on_png_warning);
  png_infop info = png != NULL ? png_create_info_struct(png) : NULL;
  volatile bool good = false;
  if (info != NULL && setjmp(png_jmpbuf(png)) == 0) {
    png_init_io(png, from);
    png_set_user_limits(png, CLI_IMAGE_SIDE_MAX, CLI_IMAGE_SIDE_MAX);
    good = read_png_rows(png, info, file, file_bytes, linear, reading, image);
  }
  png_destroy_read_struct(&png, &info, NULL);
  free(reading->rows);
  free(reading->bytes);
  free(reading);
  return good;
}

static void put_png_rows(png_structp png, png_infop info, const cli_image *image, uint8_t *row) {
  const size_t count = image->width * image->channels;
  png_set_IHDR(png, info, (png_uint_32)image->width, (png_uint_32)image->height, 16,
               image->channels == 3 ? PNG_COLOR_TYPE_RGB : PNG_COLOR_TYPE_GRAY, PNG_INTERLACE_NONE,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  png_set_gAMA(png, info, 1);
  png_set_compression_level(png, 1);
  png_write_info(png, info);
  for (size_t y = 0; y < image->height; y++) {
    for (size_t i = 0; i < count; i++) {
      const float value = image->values[y * count + i];
      const long share = value >= 0 && value <= 1 ? lrint((double)value * 65535) : 0;
      row[2 * i] = (uint8_t)(share >> 8);
      row[2 * i + 1] = (uint8_t)share;
    }
    png_write_row(png, row);
  }
  png_write_end(png, NULL);
}

static bool write_png(const char *file, FILE *to, const cli_image *image) {
  uint8_t *row = cli_allocate(image->width * image->channels, sizeof(uint16_t));
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, (png_voidp)(uintptr_t)file,
                                            on_png_error, on_png_warning);
  png_infop info = png != NULL ? png_create_info_struct(png) : NULL;
  volatile bool good = false;
  if (info != NULL && setjmp(png_jmpbuf(png)) == 0) {
    png_init_io(png, to);
    put_png_rows(png, info, image, row);
    good = true;
  }
  png_destroy_write_struct(&png, &info);
  free(row);
  return good;
}

/* ---- PFM ------------------------------------------------------------------------------------- */

/* Reads the header: PF (colour) or Pf (grey), the size, and a number whose sign is that of the byte
 * order, below 0 for little-endian. One white space follows, or the end of a line of Windows, then
 * the rows, the last one first. */
static bool read_pfm(const char *file, FILE *from, size_t file_bytes, cli_image *image) {
  char kind, space;
  unsigned width, height;
  double scale;
  if (fscanf(from, "P%c %6u %6u %lf%c", &kind, &width, &height, &scale, &space) != 5 ||
      (kind != 'F' && kind != 'f')) {
    return fail(file, "it is neither a PNG nor a PFM");
  }
  if (!(scale < 0)) {
    return fail(file, "this PFM is big-endian: write it as little-endian, with a negative scale");
  }
  const size_t channels = kind == 'F' ? 3 : 1, left = file_bytes - (size_t)ftell(from);
  const uint64_t bytes = (uint64_t)width * height * channels * sizeof(float);
  if (width <= CLI_IMAGE_SIDE_MAX && height <= CLI_IMAGE_SIDE_MAX && left < bytes) {
    return fail(file, "the PFM ends too early");
  }
  if (!allocate(file, width, height, channels, image)) {
    return false;
  }
  if (space == '\r' && left > bytes) {
    const int next = getc(from);
    ungetc(next != '\n' ? next : EOF, from);
  }
  const size_t count = image->width * image->channels;
  for (size_t y = image->height; y-- > 0;) {
    if (fread(image->values + y * count, sizeof(float), count, from) != count) {
      return fail(file, "the PFM ends too early");
    }
  }
  return true;
}

static bool write_pfm(FILE *to, const cli_image *image) {
  const size_t count = image->width * image->channels;
  fprintf(to, "P%c\n%zu %zu\n-1.0\n", image->channels == 3 ? 'F' : 'f', image->width,
          image->height);
  for (size_t y = image->height; y-- > 0;) {
    fwrite(image->values + y * count, sizeof(float), count, to);
  }
  return true;
}

/* ---- files ----------------------------------------------------------------------------------- */

static bool ends_with(const char *file, const char *suffix) {
  const size_t length = strlen(file), end = strlen(suffix);
  return length > end && strcmp(file + length - end, suffix) == 0;
}

bool cli_image_read(const char *file, bool linear, cli_image *image) {
  uint8_t start[8];
  image->values = NULL;
  FILE *from = fopen(file, "rb");
  if (from == NULL) {
    return fail(file, strerror(errno));
  }
  const size_t got = fread(start, 1, sizeof start, from);
  const size_t bytes = fseek(from, 0, SEEK_END) == 0 ? (size_t)ftell(from) : SIZE_MAX;
  rewind(from);
  const bool good = got == sizeof start && png_sig_cmp(start, 0, sizeof start) == 0
                        ? read_png(file, from, bytes, linear, image)
                        : read_pfm(file, from, bytes, image);
  fclose(from);
  if (!good) {
    free(image->values);
    image->values = NULL;
  }
  return good;
}

bool cli_image_can_write(const char *file, bool shares) {
  return ends_with(file, ".pfm") || (shares && ends_with(file, ".png"));
}

bool cli_image_write(const char *file, const cli_image *image) {
  FILE *to = fopen(file, "wb");
  if (to == NULL) {
    return fail(file, strerror(errno));
  }
  errno = 0;
  const bool written = ends_with(file, ".png") ? write_png(file, to, image) : write_pfm(to, image);
  const bool good = !ferror(to) && written;
  if (fclose(to) != 0 || !good) {
    return written ? fail(file, errno != 0 ? strerror(errno) : "it cannot be written") : false;
  }
  return true;
}

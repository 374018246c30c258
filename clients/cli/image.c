#include "clients/cli/image.h"

#include <errno.h>
#include <lcms2.h>
#include <math.h>
#include <png.h>
#include <stdlib.h>
#include <string.h>

enum { SIDE_MAX = 65536 };

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "PFM is written little-endian");

static bool fail(const char *file, const char *what) {
  return cli_fails("%s: %s", file, what);
}

/* Allocates the values of an image of this size, if it is one that is supported. */
static bool allocate(const char *file, size_t width, size_t height, size_t channels,
                     cli_image *of) {
  if (width < 1 || height < 1 || width > SIDE_MAX || height > SIDE_MAX) {
    return fail(file, "its width and height are not from 1 to 65536");
  }
  const uint64_t bytes = (uint64_t)width * height * channels * sizeof *of->values;
  *of = (cli_image){width, height, channels, NULL};
  of->values = bytes <= SIZE_MAX ? malloc((size_t)bytes) : NULL;
  return of->values != NULL || fail(file, "there is no memory for an image of its size");
}

/* ---- PNG ------------------------------------------------------------------------------------- */

static void on_png_error(png_structp png, png_const_charp what) {
  fail(png_get_error_ptr(png), what);
  png_longjmp(png, 1);
}

/* Says why libpng leaves a colour profile out. One of sRGB is known without it. */
static void on_png_warning(png_structp png, png_const_charp what) {
  if (strncmp(what, "iCCP", 4) == 0 && strstr(what, "known incorrect sRGB") == NULL) {
    cli_say(CLI_OK, "%s: its colour profile is not used: %s", (const char *)png_get_error_ptr(png),
            what);
  }
}

/* Makes a profile of grey or of the primaries of sRGB (ITU-R BT.709). Frees the curve. */
static cmsHPROFILE make_profile(size_t channels, cmsToneCurve *curve) {
  const cmsCIExyY white = {0.3127, 0.3290, 1};
  const cmsCIExyYTRIPLE primaries = {{0.64, 0.33, 1}, {0.30, 0.60, 1}, {0.15, 0.06, 1}};
  cmsToneCurve *const curves[] = {curve, curve, curve};
  cmsHPROFILE made = channels == 3 ? cmsCreateRGBProfile(&white, &primaries, curves)
                                   : cmsCreateGrayProfile(cmsD50_xyY(), curve);
  cmsFreeToneCurve(curve);
  return made;
}

/* Returns how a file says that its values become linear light: cICP goes first, then sRGB, iCCP and
 * gAMA (Portable Network Graphics, third edition). Without a word they are sRGB, and so they are
 * where gAMA is nearly 1 / 2.2, which files that are sRGB say; NULL if that is not known. */
static cmsHPROFILE profile_of(png_structp png, png_infop info, size_t channels) {
  enum { CICP_SRGB = 13, OF_SRGB = 4 };
  const double sRGB[] = {2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045}; /* IEC 61966-2-1 */
  png_unknown_chunkp chunks = NULL;
  double gamma = 0;
  png_charp name;
  png_bytep bytes;
  png_uint_32 count;
  int method;
  bool known = png_get_valid(png, info, PNG_INFO_sRGB) != 0;
  if (png_get_unknown_chunks(png, info, &chunks) > 0) { /* only the chunk cICP is kept */
    known = chunks[0].size == 4 && chunks[0].data[1] == CICP_SRGB;
    if (!known) {
      return NULL;
    }
  }
  if (!known && png_get_iCCP(png, info, &name, &method, &bytes, &count) != 0) {
    return cmsOpenProfileFromMem(bytes, count);
  }
  const bool states = !known && png_get_gAMA(png, info, &gamma) != 0 && gamma > 0;
  return make_profile(channels, states && fabs(gamma * 2.2 - 1) > 0.01
                                    ? cmsBuildGamma(NULL, 1 / gamma)
                                    : cmsBuildParametricToneCurve(NULL, OF_SRGB, sRGB));
}

/* Makes linear light of the primaries of sRGB of the values of an image. */
static bool make_linear(png_structp png, png_infop info, const char *file, cli_image *of) {
  const cmsUInt32Number type = of->channels == 3 ? TYPE_RGB_FLT : TYPE_GRAY_FLT;
  cmsHPROFILE from = profile_of(png, info, of->channels);
  cmsHPROFILE to = make_profile(of->channels, cmsBuildGamma(NULL, 1));
  cmsHTRANSFORM made = from == NULL
                           ? NULL
                           : cmsCreateTransform(from, type, to, type, INTENT_RELATIVE_COLORIMETRIC,
                                                cmsFLAGS_NOOPTIMIZE | cmsFLAGS_NOCACHE);
  for (size_t y = 0; made != NULL && y < of->height; y++) {
    float *row = of->values + y * of->width * of->channels;
    cmsDoTransform(made, row, row, (cmsUInt32Number)of->width);
  }
  if (made != NULL) {
    cmsDeleteTransform(made);
  } else {
    fail(file, "it says what its values are by a cICP chunk or a colour profile that is not known "
               "here: save it as sRGB, or add --linear if its values are linear");
  }
  cmsCloseProfile(to);
  cmsCloseProfile(from);
  return made != NULL;
}

/* Takes the values of one row as shares of the largest. Returns how many pixels are opaque. */
static size_t take_row(const uint8_t *row, unsigned bits, size_t samples, const cli_image *of,
                       float *values) {
  const size_t bytes = bits / 8;
  size_t opaque = 0;
  for (size_t x = 0; x < of->width; x++, row += samples * bytes) {
    for (size_t c = 0; c < of->channels; c++) {
      const uint8_t *at = row + c * bytes;
      *values++ = (float)(bits == 8 ? *at / 255.0 : (at[0] * 256 + at[1]) / 65535.0);
    }
    const uint8_t *last = row + samples * bytes - bytes;
    opaque += samples == of->channels || (last[0] == 255 && last[bytes - 1] == 255);
  }
  return opaque;
}

/* Deflate makes data at most this many times smaller. */
enum { DEFLATE_RATIO_MAX = 1032 };

/* Reads the header and makes libpng give 8 or 16 bits of 1 or 3 channels, and maybe an opacity. */
static bool start_png(png_structp png, png_infop info, const char *file, size_t file_bytes,
                      cli_image *of) {
  png_set_keep_unknown_chunks(png, PNG_HANDLE_CHUNK_ALWAYS, (png_const_bytep) "cICP", 1);
  png_read_info(png, info);
  const unsigned type = png_get_color_type(png, info);
  if (png_get_image_height(png, info) / DEFLATE_RATIO_MAX * png_get_rowbytes(png, info) >
      file_bytes) {
    return fail(file, "the PNG ends too early");
  }
  png_set_expand(png); /* palettes become colours, and fewer than 8 bits become 8 */
  const int passes = png_set_interlace_handling(png);
  png_read_update_info(png, info);
  (void)passes;
  return allocate(file, png_get_image_width(png, info), png_get_image_height(png, info),
                  (type & PNG_COLOR_MASK_COLOR) != 0 ? 3 : 1, of);
}

/* What has to be freed even if libpng fails halfway. */
struct png_reading {
  uint8_t *bytes;
  uint8_t **rows;
};

static bool read_png_rows(png_structp png, png_infop info, const char *file, size_t file_bytes,
                          bool linear, struct png_reading *reading, cli_image *of) {
  if (!start_png(png, info, file, file_bytes, of)) {
    return false;
  }
  const size_t row_bytes = png_get_rowbytes(png, info);
  reading->bytes = malloc(row_bytes * of->height);
  reading->rows = calloc(of->height, sizeof *reading->rows);
  if (reading->bytes == NULL || reading->rows == NULL) {
    return fail(file, "there is no memory for an image of its size");
  }
  for (size_t y = 0; y < of->height; y++) {
    reading->rows[y] = reading->bytes + y * row_bytes;
  }
  png_read_image(png, reading->rows);
  png_read_end(png, NULL);
  const size_t pixels = of->width * of->height;
  size_t opaque = 0;
  for (size_t y = 0; y < of->height; y++) {
    opaque += take_row(reading->rows[y], png_get_bit_depth(png, info), png_get_channels(png, info),
                       of, of->values + y * of->width * of->channels);
  }
  if (opaque < pixels) {
    cli_say(CLI_OK, "%s: %zu of %zu pixels are not opaque; their opacity (alpha) is left out", file,
            pixels - opaque, pixels);
  }
  return linear || make_linear(png, info, file, of);
}

static bool read_png(const char *file, FILE *from, size_t file_bytes, bool linear, cli_image *of) {
  struct png_reading *reading = cli_allocate(1, sizeof *reading);
  png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, (png_voidp)(uintptr_t)file,
                                           on_png_error, on_png_warning);
  png_infop info = png != NULL ? png_create_info_struct(png) : NULL;
  volatile bool good = false;
  if (info != NULL && setjmp(png_jmpbuf(png)) == 0) {
    png_init_io(png, from);
    png_set_user_limits(png, SIDE_MAX, SIDE_MAX);
    good = read_png_rows(png, info, file, file_bytes, linear, reading, of);
  }
  png_destroy_read_struct(&png, &info, NULL);
  free(reading->rows);
  free(reading->bytes);
  return good;
}

/* Writes 16 bits of linear values. */
static bool write_png(const char *file, FILE *to, const cli_image *of) {
  const size_t count = of->width * of->height * of->channels;
  uint16_t *shares = cli_allocate(count, sizeof *shares);
  png_image png = {.version = PNG_IMAGE_VERSION,
                   .width = (png_uint_32)of->width,
                   .height = (png_uint_32)of->height,
                   .format = of->channels == 3 ? PNG_FORMAT_LINEAR_RGB : PNG_FORMAT_LINEAR_Y,
                   .flags = PNG_IMAGE_FLAG_FAST};
  for (size_t i = 0; i < count; i++) {
    const float value = of->values[i];
    shares[i] = (uint16_t)(value >= 0 && value <= 1 ? lrint((double)value * UINT16_MAX) : 0);
  }
  const bool good = png_image_write_to_stdio(&png, to, 0, shares, 0, NULL) != 0;
  cli_free(shares);
  return good || fail(file, png.message);
}

/* ---- PFM ------------------------------------------------------------------------------------- */

/* Reads the header: PF (colour) or Pf (grey), the size, and a number whose sign is that of the byte
 * order, below 0 for little-endian. One white space follows, or the end of a line of Windows, then
 * the rows, the last one first. */
static bool read_pfm(const char *file, FILE *from, size_t file_bytes, cli_image *of) {
  char kind, space;
  size_t width, height;
  double scale;
  if (fscanf(from, "P%c %18zu %18zu %lf%c", &kind, &width, &height, &scale, &space) != 5 ||
      (kind != 'F' && kind != 'f')) {
    return fail(file, "it is neither a PNG nor a PFM");
  }
  const size_t channels = kind == 'F' ? 3 : 1, left = file_bytes - (size_t)ftell(from);
  const uint64_t bytes = (uint64_t)width * height * channels * sizeof(float);
  const bool fits = width <= SIDE_MAX && height <= SIDE_MAX;
  if (fits && !(scale < 0)) {
    return fail(file, "this PFM is big-endian: write it as little-endian, with a negative scale");
  }
  if (fits && left < bytes) {
    return fail(file, "the PFM ends too early");
  }
  if (!allocate(file, width, height, channels, of)) {
    return false;
  }
  if (space == '\r' && left > bytes) {
    const int next = getc(from);
    ungetc(next != '\n' ? next : EOF, from);
  }
  const size_t count = of->width * of->channels;
  for (size_t y = of->height; y-- > 0;) {
    if (fread(of->values + y * count, sizeof(float), count, from) != count) {
      return fail(file, "the PFM ends too early");
    }
  }
  return true;
}

bool cli_image_put(const char *name, FILE *to, bool png, const cli_image *of) {
  const size_t count = of->width * of->channels;
  if (png) {
    return write_png(name, to, of);
  }
  fprintf(to, "P%c\n%zu %zu\n-1.0\n", of->channels == 3 ? 'F' : 'f', of->width, of->height);
  for (size_t y = of->height; y-- > 0;) {
    fwrite(of->values + y * count, sizeof(float), count, to);
  }
  return true;
}

/* ---- files ----------------------------------------------------------------------------------- */

bool cli_image_read(const char *file, bool linear, cli_image *of) {
  uint8_t start[8];
  of->values = NULL;
  FILE *from = fopen(file, "rb");
  if (from == NULL) {
    return fail(file, strerror(errno));
  }
  const size_t got = fread(start, 1, sizeof start, from);
  const size_t bytes = fseek(from, 0, SEEK_END) == 0 ? (size_t)ftell(from) : SIZE_MAX;
  rewind(from);
  const bool good = got == sizeof start && png_sig_cmp(start, 0, sizeof start) == 0
                        ? read_png(file, from, bytes, linear, of)
                        : read_pfm(file, from, bytes, of);
  fclose(from);
  if (!good) {
    free(of->values);
    of->values = NULL;
  }
  return good;
}

bool cli_image_write(const char *file, const cli_image *of) {
  FILE *to = fopen(file, "wb");
  if (to == NULL) {
    return fail(file, strerror(errno));
  }
  errno = 0;
  const bool written = cli_image_put(file, to, cli_ends_with(file, ".png"), of);
  const bool good = cli_file_end(to, file, !ferror(to) && written);
  return good || (written && fail(file, errno != 0 ? strerror(errno) : "it cannot be written"));
}

/* dipole texture: maps an image of colours to images of the media that have them. Images are PNG
 * (libpng, and lcms2 for their colours) and the portable float map PFM (Debevec 1998). */
#include <errno.h>
#include <lcms2.h>
#include <math.h>
#include <png.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "clients/cli/profile.h"
#include "clients/cli/progress.h"

static const cli_option options[] = {
    CLI_TITLE("Media"),
    CLI_LENGTH_OPTIONS,
    CLI_OPTION(ONE, g, NULL, "mean cosine of the scattering angle (default: 0)"),
    CLI_OPTION(ONE, eta, "1.3", "refractive index inside over outside"),
    CLI_TITLE("Colours"),
    CLI_COLOUR_OPTIONS,
    CLI_OPTION(SWITCH, linear, NULL,
               "treat the values of a PNG as linear (default: what the file says, by a "
               "colour profile or gAMA, else sRGB)"),
    CLI_OPTION(NAMES, coefficients, NULL,
               "what to write: sigma_a, sigma_s (1/mm), and scattered, the single-scattering "
               "albedo for random walks (default: sigma_a,sigma_s)"),
    CLI_TITLE("Evaluation"),
    CLI_OPTION(NAME, model, CLI_MODEL_DEFAULT, "the model that the colours are right for"),
    CLI_MOMENTS_OPTION,
    CLI_DEADLINE_OPTION,
    {0},
};

enum { SIDE_MAX = 65536 };

/* An image with 1 (grey) or 3 (red, green, blue) channels. */
typedef struct image {
  size_t width, height; /* 1 to SIDE_MAX */
  size_t channels;
  float *values; /* [height][width][channels], the first row at the top */
} image;

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "PFM is written little-endian");

static bool fail(const char *file, const char *what) {
  return cli_fails("%s: %s", file, what);
}

/* Allocates the values of an image of this size, if it is one that is supported. */
static bool allocate(const char *file, size_t width, size_t height, size_t channels, image *of) {
  if (width < 1 || height < 1 || width > SIDE_MAX || height > SIDE_MAX) {
    return fail(file, "its width and height are not from 1 to 65536");
  }
  const uint64_t bytes = (uint64_t)width * height * channels * sizeof *of->values;
  *of = (image){width, height, channels, NULL};
  of->values = bytes <= SIZE_MAX ? malloc((size_t)bytes) : NULL;
  return of->values != NULL || fail(file, "there is no memory for an image of its size");
}

/* ---- PNG ------------------------------------------------------------------------------------- */

static void on_png_error(png_structp png, png_const_charp what) {
  fail(png_get_error_ptr(png), what);
  png_longjmp(png, 1);
}

/* Says why a colour profile is not used; libpng then leaves it out. One of sRGB is known without
 * it. */
static void on_png_warning(png_structp png, png_const_charp what) {
  if (strncmp(what, "iCCP", 4) == 0 && strstr(what, "known incorrect sRGB") == NULL) {
    cli_say(CLI_OK, "%s: its colour profile is not used: %s", (const char *)png_get_error_ptr(png),
            what);
  }
}

/* Makes the profile of grey values, or of those with the primaries of sRGB (ITU-R BT.709). Frees
 * the curve. */
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
 * where gAMA is nearly 1 / 2.2, which files that are sRGB say. Returns NULL if that is not
 * known. */
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
static bool make_linear(png_structp png, png_infop info, const char *file, image *of) {
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
static size_t take_row(const uint8_t *row, unsigned bits, size_t samples, const image *of,
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
                      image *of) {
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
                          bool linear, struct png_reading *reading, image *of) {
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

static bool read_png(const char *file, FILE *from, size_t file_bytes, bool linear, image *of) {
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
static bool write_png(const char *file, FILE *to, const image *of) {
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
static bool read_pfm(const char *file, FILE *from, size_t file_bytes, image *of) {
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

static bool write_pfm(FILE *to, const image *of) {
  const size_t count = of->width * of->channels;
  fprintf(to, "P%c\n%zu %zu\n-1.0\n", of->channels == 3 ? 'F' : 'f', of->width, of->height);
  for (size_t y = of->height; y-- > 0;) {
    fwrite(of->values + y * count, sizeof(float), count, to);
  }
  return true;
}

/* ---- files ----------------------------------------------------------------------------------- */

/* Reads a file: PNG or PFM, as its first bytes say. Says on standard error if an opacity is left
 * out. The values of a PNG are shares of the largest one; unless `linear`, they become linear light
 * of the primaries of sRGB, as the file says by a colour profile or gAMA, else from sRGB. Says what
 * is wrong and returns false if it cannot be read. */
static bool read_image(const char *file, bool linear, image *of) {
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

/* Writes a file: PFM, or a PNG of 16 bits with linear values, as its name says; in a PNG NaN is 0.
 * Says what is wrong and returns false if it cannot be written. */
static bool write_image(const char *file, const image *of) {
  FILE *to = fopen(file, "wb");
  if (to == NULL) {
    return fail(file, strerror(errno));
  }
  errno = 0;
  const bool written = cli_ends_with(file, ".png") ? write_png(file, to, of) : write_pfm(to, of);
  const bool good = !ferror(to) && written;
  if (fclose(to) != 0 || !good) {
    return written ? fail(file, errno != 0 ? strerror(errno) : "it cannot be written") : false;
  }
  return true;
}

/* ---- the command line ------------------------------------------------------------------------ */

/* Values of one request: 2 MiB and some ten milliseconds. */
enum { REQUEST_VALUES = 262144, WANTED_MAX = 8 };

typedef struct texture_run {
  const cli_settings *settings;
  dipole_client *client;
  cli_profile names;
  dipole_varying_query query;
  size_t wanted_count;
  const dipole_choice *wanted[WANTED_MAX];
  image images[WANTED_MAX]; /* images of the wanted coefficients */
  float *lengths_mm;        /* [REQUEST_VALUES] */
  uint64_t missing;         /* number of values whose colour no medium has */
  uint64_t first_missing;   /* index of the first of them */
  unsigned missing_status;
  double colour_least, colour_most;
} texture_run;

static int check(cli_settings *settings) {
  const char *length;
  if (settings->operand == NULL || settings->second_operand == NULL) {
    return cli_fail_usage("name two files: the image that is read, and the image that is written");
  }
  const cli_numbers *lengths = cli_lengths_find(settings, &length);
  if (lengths == NULL) {
    return CLI_USAGE;
  }
  if (lengths->count != 1 && lengths->count != CLI_COLOURS) {
    return cli_fail_usage("--%s has %zu values: give one, or three for red, green and blue", length,
                          lengths->count);
  }
  return CLI_OK;
}

/* Finds the coefficients that are wanted. */
static bool take_wanted(texture_run *run, const dipole_info *info) {
  static char *usual[] = {"sigma_a", "sigma_s"};
  const cli_texts *names = &run->settings->coefficients;
  const size_t count = names->count > 0 ? names->count : 2;
  for (size_t i = 0; i < count && i < WANTED_MAX; i++) {
    const dipole_choice *found = cli_named(info, DIPOLE_COEFFICIENT, "coefficients",
                                           names->count > 0 ? names->items[i] : usual[i]);
    if (found == NULL) {
      return false;
    }
    if ((run->query.coefficients & found->id) == 0) {
      run->query.coefficients |= found->id;
      run->wanted[run->wanted_count++] = found;
    }
  }
  return true;
}

static int take_settings(texture_run *run) {
  const cli_settings *settings = run->settings;
  const char *length;
  cli_lengths_find(settings, &length);
  if (!cli_profile_take_names(settings, run->client, &run->names)) {
    return CLI_USAGE;
  }
  const dipole_info *info = run->names.info;
  const dipole_choice *light = cli_named(info, DIPOLE_LIGHT, "light", settings->light);
  const dipole_choice *given = cli_choice(info, DIPOLE_LENGTH, length);
  if (light == NULL || given == NULL || !take_wanted(run, info)) {
    return CLI_USAGE;
  }
  const bool shares = run->query.coefficients == DIPOLE_SCATTERED;
  if (!cli_ends_with(settings->second_operand, ".pfm") &&
      !(shares && cli_ends_with(settings->second_operand, ".png"))) {
    return cli_fail_usage("%s: the name of the image that is written ends with .pfm, or with .png "
                          "if --coefficients is scattered",
                          settings->second_operand);
  }
  run->query = (dipole_varying_query){.model = run->names.model->id,
                                      .evaluator = DIPOLE_F32,
                                      CLI_QUERY_OF(&run->names),
                                      .coefficients = run->query.coefficients,
                                      .light = light->id,
                                      .given = given->id,
                                      .specular = settings->specular,
                                      .g = cli_numbers_pick(&settings->g, 0, 0),
                                      .eta = settings->eta.items[0],
                                      CLI_DEADLINE_OF(settings)};
  return CLI_OK;
}

/* ---- requests ---------------------------------------------------------------------------------- */

/* Fills the lengths of `count` values from number `first` on. */
static void set_lengths(texture_run *run, uint64_t first, size_t count, size_t channels) {
  const char *name;
  const cli_numbers *lengths = cli_lengths_find(run->settings, &name);
  const double unit_mm = cli_unit_mm(run->settings);
  for (size_t i = 0; i < count; i++) {
    const size_t channel = lengths->count == 1 ? 0 : (size_t)((first + i) % channels);
    run->lengths_mm[i] = (float)(unit_mm * lengths->items[channel]);
  }
}

static void take_values(texture_run *run, uint64_t first, const dipole_varying_result *result) {
  for (size_t i = 0; i < run->wanted_count; i++) {
    memcpy(run->images[i].values + first, dipole_coefficients_f32(result, run->wanted[i]->id),
           (size_t)result->value_count * sizeof(float));
  }
  run->colour_least = result->colour_least;
  run->colour_most = result->colour_most;
  if (run->missing == 0 && result->computed_count < result->value_count) {
    uint64_t i = 0;
    while (result->statuses[i] == DIPOLE_VALUE_OK || result->statuses[i] == DIPOLE_VALUE_FAR) {
      i++;
    }
    run->first_missing = first + i;
    run->missing_status = result->statuses[i];
  }
  run->missing += result->value_count - result->computed_count;
}

static bool map(texture_run *run, const image *in, dipole_error *error) {
  cli_progress progress;
  const uint64_t count = in->width * in->height * in->channels;
  bool good = true;
  cli_progress_start(&progress, "values");
  for (uint64_t first = 0; good && first < count; first += REQUEST_VALUES) {
    dipole_varying_result *result;
    const uint64_t left = count - first;
    const size_t n = left < REQUEST_VALUES ? (size_t)left : REQUEST_VALUES;
    set_lengths(run, first, n, in->channels);
    run->query.colours = in->values + first;
    run->query.lengths_mm = run->lengths_mm;
    run->query.value_count = n;
    good =
        CLI_RETRY(run->settings, error, dipole_varying(run->client, &run->query, &result, error));
    if (good) {
      take_values(run, first, result);
      dipole_varying_result_free(result);
      cli_progress_show(&progress, (double)(first + n) / (double)count, (double)(first + n));
    }
  }
  cli_progress_wipe(&progress);
  return good;
}

/* ---- the command ----------------------------------------------------------------------------- */

/* Says how many values have no medium, and where the first one is. Returns an exit status. */
static int report_missing(const texture_run *run, const image *in) {
  static const char *const grey[] = {"grey"};
  if (run->missing == 0) {
    return CLI_OK;
  }
  const dipole_choice *status =
      cli_choice_of_id(dipole_get_info(run->client), DIPOLE_VALUE, run->missing_status);
  const uint64_t pixel = run->first_missing / in->channels;
  const char *const *channels = in->channels == CLI_COLOURS ? cli_colours : grey;
  cli_say(CLI_BAD_ROWS,
          "%s: %llu of %llu values are NaN in what was written: no medium has their colour, which "
          "is from %.6g to %.6g, or their length; the first is %s of column %llu, row %llu: %s: "
          "allowed: %s",
          run->settings->operand, (unsigned long long)run->missing,
          (unsigned long long)(in->width * in->height * in->channels), run->colour_least,
          run->colour_most, channels[run->first_missing % in->channels],
          (unsigned long long)(pixel % in->width), (unsigned long long)(pixel / in->width),
          status != NULL ? status->name : "unknown", status != NULL ? status->about : "others");
  return CLI_BAD_ROWS;
}

/* Writes OUT, or with several coefficients OUT with the name of each before the ending, as in
 * skin.sigma_a.pfm. */
static int write_images(const texture_run *run) {
  const char *out = run->settings->second_operand, *ending = strrchr(out, '.');
  bool good = true;
  for (size_t i = 0; good && i < run->wanted_count; i++) {
    char *file = NULL;
    good = run->wanted_count == 1 ? write_image(out, &run->images[i])
                                  : asprintf(&file, "%.*s.%s%s", (int)(ending - out), out,
                                             run->wanted[i]->name, ending) > 0 &&
                                        write_image(file, &run->images[i]);
    free(file);
  }
  return good ? CLI_OK : CLI_FAILED;
}

static int map_image(texture_run *run, const image *in) {
  dipole_error error;
  const uint64_t count = in->width * in->height * in->channels;
  for (size_t i = 0; i < run->wanted_count; i++) {
    run->images[i] = *in;
    run->images[i].values = cli_allocate(count, sizeof(float));
  }
  run->lengths_mm = cli_allocate(REQUEST_VALUES, sizeof *run->lengths_mm);
  int status = map(run, in, &error) ? write_images(run) : cli_fail_error(&error);
  if (status == CLI_OK) {
    status = report_missing(run, in);
  }
  return status;
}

static int run_texture(const cli_settings *settings, dipole_client *client) {
  texture_run work = {.settings = settings, .client = client};
  image in;
  int status = take_settings(&work);
  if (status == CLI_OK) {
    status = read_image(settings->operand, settings->linear, &in) ? CLI_OK : CLI_FAILED;
    if (status == CLI_OK) {
      status = map_image(&work, &in);
      free(in.values);
    }
  }
  return status;
}

const cli_command cli_command_texture = {
    .name = "texture",
    .operand = "IN",
    .second_operand = "OUT",
    .about = "Map an image of colours to images of the media that have them",
    .more =
        "IN is a PNG or a PFM (portable float map). Each of its values is a colour: the diffuse "
        "albedo, the share that leaves of the power that entered. OUT ends with .pfm or, "
        "with --coefficients scattered, with .png; with several coefficients their names stand "
        "before the ending, as in skin.sigma_a.pfm. "
        "The media have the colours under the model, to 1e-5 with transport. A colour that no "
        "medium has becomes NaN; then the exit status is 3. An EXR goes through `ffmpeg -i "
        "skin.exr skin.pfm` before, and what is written through `ffmpeg -i skin.sigma_a.pfm "
        "sigma_a.exr`. Both keep the numbers. FFmpeg 5.1 turns a PFM upside down when it writes "
        "and reads one: add `-vf vflip` if the image that went in was no EXR.",
    .formats = "none",
    .options = {options},
    .parameters = CLI_OF_INVERTED,
    .examples =
        "  dipole texture skin.png skin.pfm --mean-free-path 1,.5,.3\n"
        "  dipole texture skin.png albedo.png --mean-free-path 1 --coefficients scattered\n",
    .check = check,
    .run = run_texture,
};

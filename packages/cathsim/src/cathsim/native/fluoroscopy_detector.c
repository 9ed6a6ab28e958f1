/* A detector's image: the wire's transmission drawn along a polyline, and counting, blur and display of the photons. */
#include "wide.h"

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

typedef struct {
  int left, top, width, height; /* window of the image, px */
  int sections, rows, entries;  /* of `profiles`: materials, wire radii, squared distances */
  const float* profiles;        /* sections x rows x entries, transmission by squared distance from the axis */
  const float* reach;           /* sections x rows, px: where a profile ends */
  const float* mask_reach;      /* rows, px */
  float apart;                  /* px along the wire; strands further apart than this attenuate one after the other */
} WireWindow;

/* Draws a polyline (count x 2, px) into the window. `along` is the arc length (px) at each point, `section` and `row`
 * choose the profile of the piece that follows it. `strand`, `under` and `last` (window) hold the transmission of the
 * strand being drawn, of those before it, and the arc length of the last visit; `strand` and `under` start at 1 and
 * `last` far below 0. The result is under * strand, left in `strand`. `mask` (window) starts at 0. Within a strand the
 * darkest piece wins; with `nearest` (window, else NULL), of a tube, which is darkest off its axis, the nearest. */
void cathsim_wire_draw(const WireWindow* w, int count, const float* points, const float* along, const int* section,
                       const int* row, float* strand, float* under, float* last, unsigned char* mask,
                       float* nearest) {
  for (int i = 0; i + 1 < count; i++) {
    const size_t profile = (size_t)section[i] * w->rows + row[i];
    const float* table = w->profiles + profile * w->entries;
    const float ink = w->reach[profile], covered = w->mask_reach[row[i]], reach = fmaxf(ink, covered);
    const float u0 = points[2 * i] - w->left, v0 = points[2 * i + 1] - w->top;
    const float du = points[2 * i + 2] - points[2 * i], dv = points[2 * i + 3] - points[2 * i + 1];
    const float first = floorf(fminf(u0, u0 + du) - reach), end = ceilf(fmaxf(u0, u0 + du) + reach);
    const float highest = floorf(fminf(v0, v0 + dv) - reach), lowest = ceilf(fmaxf(v0, v0 + dv) + reach);
    if (!(end >= 0 && lowest >= 0 && first < w->width && highest < w->height)) continue;
    const int left = first > 0 ? (int)first : 0, right = end < w->width - 1 ? (int)end : w->width - 1;
    const int top = highest > 0 ? (int)highest : 0, bottom = lowest < w->height - 1 ? (int)lowest : w->height - 1;
    const float length2 = du * du + dv * dv, inverse = length2 > 1e-12f ? 1 / length2 : 0;
    const float ink2 = ink * ink, covered2 = covered * covered, scale = (float)(w->entries - 1) / ink2;
    for (int y = top; y <= bottom; y++) {
      for (int x = left; x <= right; x++) {
        const float px = (float)x - u0, py = (float)y - v0;
        float t = (px * du + py * dv) * inverse;
        t = t < 0 ? 0 : t > 1 ? 1 : t;
        const float dx = px - t * du, dy = py - t * dv, d2 = dx * dx + dy * dy;
        const size_t k = (size_t)y * w->width + x;
        if (d2 <= covered2) mask[k] = 1;
        if (d2 >= ink2) continue;
        const float position = d2 * scale;
        const int entry = (int)position;
        const float low = table[entry], high = table[entry + 1 < w->entries ? entry + 1 : entry];
        const float transmission = low + (position - (float)entry) * (high - low);
        if (along[i] - last[k] > w->apart) {
          under[k] *= strand[k];
          strand[k] = transmission;
          if (nearest) nearest[k] = d2;
        } else if (nearest ? d2 < nearest[k] : transmission < strand[k]) {
          strand[k] = transmission;
          if (nearest) nearest[k] = d2;
        }
        last[k] = along[i];
      }
    }
  }
  const size_t size = (size_t)w->width * w->height;
  for (size_t k = 0; k < size; k++) strand[k] *= under[k];
}

typedef struct {
  int width, height;
  const float* primary;        /* height x width, expected photons that pass straight through all but the wire */
  const float* veil;           /* height x width, expected photons of scatter and glare */
  int left, top, wide, high;   /* window of `transmission` */
  const float* transmission;   /* high x wide, of the wire */
  float white;                 /* photons of grey level 255 */
  float video;                 /* standard deviation of the display chain's noise, grey levels */
  int counting;                /* whether photons are counted; otherwise the image is that of the expectation */
  int radius;                  /* of the kernel, px */
  const float* kernel;         /* radius + 1 weights of the blur behind the counting, centre first */
  const float* normal;         /* NORMALS quantiles of the standard normal distribution */
} Exposure;

enum { NORMALS = 4096, MAX_WIDTH = 4096, MAX_RADIUS = 16, FEW = 10 };

static inline uint64_t draw(uint64_t* state) {
  uint64_t z = (*state += 0x9e3779b97f4a7c15u);
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return z ^ (z >> 31);
}

/* Poisson count of a small expectation by inversion; `u` in (0, 1). */
static float few_photons(float expected, float u) {
  float p = expf(-expected), sum = p;
  int n = 0;
  while (u > sum && n < 60) {
    n++;
    p *= expected / (float)n;
    sum += p;
  }
  return (float)n;
}

/* Many photons: the normal quantile z, with the distribution's skewness to first order (Cornish and Fisher). */
static inline float photons(float expected, float z) { return expected + sqrtf(expected) * z + (z * z - 1) / 6; }

/* Expected photons of a row. */
WIDE static void expect_row(const Exposure* e, int row, float* restrict out) {
  const size_t start = (size_t)row * e->width;
  const float *primary = e->primary + start, *veil = e->veil + start;
  for (int x = 0; x < e->width; x++) out[x] = primary[x] + veil[x];
  if (e->transmission && row >= e->top && row < e->top + e->high) {
    const float* t = e->transmission + (size_t)(row - e->top) * e->wide;
    for (int x = 0; x < e->wide; x++) out[e->left + x] = primary[e->left + x] * t[x] + veil[e->left + x];
  }
}

/* Counts of `width` pixels by their expectation. `chance` holds 16 random bits a pixel. */
WIDE static void count_row(const float* restrict expected, const uint16_t* restrict chance, const float* normal,
                           int width, float* restrict counts) {
  float few = 0;
  for (int x = 0; x < width; x++) {
    counts[x] = photons(expected[x], normal[chance[x] >> 4]);
    few += expected[x] < FEW;
  }
  if (few == 0) return;
  for (int x = 0; x < width; x++)
    if (!(expected[x] >= FEW)) counts[x] = few_photons(expected[x], ((float)chance[x] + 0.5f) / 65536.0f);
}

/* `counts` has `radius` values on either side of its row. */
WIDE static void blur_row(const float* restrict counts, const float* kernel, int radius, int width,
                          float* restrict out) {
  const float* in = counts + radius;
  for (int x = 0; x < width; x++) out[x] = kernel[0] * in[x];
  for (int k = 1; k <= radius; k++) {
    const float weight = kernel[k];
    for (int x = 0; x < width; x++) out[x] += weight * (in[x - k] + in[x + k]);
  }
}

WIDE static void add_row(const float* restrict row, float weight, int width, float* restrict sum) {
  for (int x = 0; x < width; x++) sum[x] += weight * row[x];
}

/* What the display shows of light: its square root. */
WIDE static void show_row(float* sum, float gain, int width) {
  for (int x = 0; x < width; x++) sum[x] = 255 * sqrtf((sum[x] > 0 ? sum[x] : 0) * gain) + 0.5f;
}

WIDE static void add_noise(float* restrict sum, float spread, const uint16_t* restrict chance,
                           const float* restrict normal, int width) {
  for (int x = 0; x < width; x++) sum[x] += spread * normal[chance[x] >> 4];
}

WIDE static void quantise_row(const float* restrict sum, int width, unsigned char* restrict out) {
  for (int x = 0; x < width; x++) {
    const float level = sum[x] > 0 ? sum[x] : 0;
    out[x] = (unsigned char)(int)(level < 255.0f ? level : 255.0f);
  }
}

/* 16 random bits for each of `width` pixels. */
static void draw_row(uint64_t state, int width, uint16_t* chance) {
  for (int x = 0; x < width; x += 4) {
    const uint64_t bits = draw(&state);
    memcpy(chance + x, &bits, sizeof bits);
  }
}

static inline int clamp(int i, int last) { return i < 0 ? 0 : i > last ? last : i; }

/* Makes the image (height x width). Every row draws from a stream of its own, so that the seed alone decides it.
 * Returns 0, or 1 where a size exceeds what this code is made for. */
int cathsim_expose(const Exposure* e, uint64_t seed, unsigned char* image) {
  static _Thread_local float ring[2 * MAX_RADIUS + 1][MAX_WIDTH], counts[MAX_WIDTH + 2 * MAX_RADIUS];
  static _Thread_local float expected[MAX_WIDTH], sum[MAX_WIDTH];
  static _Thread_local uint16_t chance[MAX_WIDTH + 8];
  if (e->width > MAX_WIDTH || e->radius > MAX_RADIUS) return 1;
  const int width = e->width, radius = e->radius, taps = 2 * radius + 1, last = e->height - 1;
  const float gain = 1 / e->white;
  for (int row = -radius; row <= last; row++) {
    /* the row that enters the blur is `radius` ahead of the one that leaves it */
    const int entering = row + radius;
    if (entering <= last) {
      float* middle = counts + radius;
      expect_row(e, entering, e->counting ? expected : middle);
      if (e->counting) {
        draw_row(seed ^ ((uint64_t)(2 * entering + 1) * 0xd1342543de82ef95u), width, chance);
        count_row(expected, chance, e->normal, width, middle);
      }
      for (int i = 0; i < radius; i++) counts[i] = middle[0], middle[width + i] = middle[width - 1];
      blur_row(counts, e->kernel, radius, width, ring[entering % taps]);
    }
    if (row < 0) continue;
    memset(sum, 0, sizeof(float) * width);
    for (int k = -radius; k <= radius; k++)
      add_row(ring[clamp(row + k, last) % taps], e->kernel[k < 0 ? -k : k], width, sum);
    show_row(sum, gain, width);
    if (e->video > 0) {
      draw_row(seed ^ ((uint64_t)(2 * row + 2) * 0xd1342543de82ef95u), width, chance);
      add_noise(sum, e->video, chance, e->normal, width);
    }
    quantise_row(sum, width, image + (size_t)row * width);
  }
  return 0;
}

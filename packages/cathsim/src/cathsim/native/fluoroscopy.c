/* Analytic fluoroscopy: path lengths of rays through the lumen, and the wire drawn over the finished background. */
#include <math.h>
#include <stddef.h>

#include "lattice.h"

#define MAX_PIECES 512 /* of one link; a link near the source could otherwise be cut without end */

typedef struct {
  int width, height;
  double projection[12];        /* 3 x 4 row-major, world (m) to pixel */
  const float* background;      /* height x width grey levels without the wire */
  const float* transmission;    /* grey level over background by squared distance from the wire's axis */
  int entries;                  /* of `transmission`, evenly over [0, ink_reach^2] */
  float ink_reach, mask_reach;  /* px from the axis to the last pixel with ink, with mask */
  double piece;                 /* px, longest straight piece of the drawn curve */
  float* nearest;               /* height x width, squared distances from the axis so far; NULL: the darkest wins */
} FluoroscopyView;

typedef struct {
  double u, v;
} Pixel;

enum { DRAWN = 0, NOT_FINITE = 1, BEHIND_SOURCE = 2 };

static int project(const FluoroscopyView* view, const double* p, Pixel* q) {
  const double* m = view->projection;
  const double w = m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11];
  if (!isfinite(p[0]) || !isfinite(p[1]) || !isfinite(p[2])) return NOT_FINITE;
  if (!(w > 1e-6)) return BEHIND_SOURCE;
  q->u = (m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3]) / w;
  q->v = (m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7]) / w;
  return DRAWN;
}

static double chord(const double* a, const double* b) {
  const double x = b[0] - a[0], y = b[1] - a[1], z = b[2] - a[2];
  return fmax(sqrt(x * x + y * y + z * z), 1e-9);
}

/* First and last pixel of an interval, clipped to the image before the cast so that huge values cannot overflow. */
static inline int first_pixel(float low) { return low > 0 ? (low < 1e9f ? (int)ceilf(low) : 1000000000) : 0; }
static inline int last_pixel(float high, int size) {
  return high < (float)(size - 1) ? (high >= 0 ? (int)high : -1) : size - 1;
}

/* Ink and mask of one straight piece. Pieces may overlap in any order: the darker value wins, or, of a tube, which is
 * darkest off its axis, that of the nearest piece. */
static void draw_piece(const FluoroscopyView* view, Pixel a, Pixel b, unsigned char* image, unsigned char* mask) {
  const float reach = fmaxf(image ? view->ink_reach : 0, mask ? view->mask_reach : 0);
  const float u0 = (float)a.u, v0 = (float)a.v, du = (float)(b.u - a.u), dv = (float)(b.v - a.v);
  const int left = first_pixel(fminf(u0, u0 + du) - reach), top = first_pixel(fminf(v0, v0 + dv) - reach);
  const int right = last_pixel(fmaxf(u0, u0 + du) + reach, view->width);
  const int bottom = last_pixel(fmaxf(v0, v0 + dv) + reach, view->height);
  if (left > right || top > bottom) return;

  const float length2 = du * du + dv * dv, inverse = length2 > 1e-12f ? 1 / length2 : 0;
  const float ink2 = view->ink_reach * view->ink_reach, mask2 = view->mask_reach * view->mask_reach;
  const float scale = (float)(view->entries - 1) / ink2;
  for (int row = top; row <= bottom; row++) {
    const float y = (float)row - v0;
    const size_t start = (size_t)row * view->width;
    for (int column = left; column <= right; column++) {
      const float x = (float)column - u0;
      float t = (x * du + y * dv) * inverse;
      t = t < 0 ? 0 : t > 1 ? 1 : t;
      const float dx = x - t * du, dy = y - t * dv, d2 = dx * dx + dy * dy;
      if (mask && d2 <= mask2) mask[start + column] = 1;
      if (image && d2 < ink2) {
        const float grey = view->background[start + column] * view->transmission[(int)(d2 * scale)] + 0.5f;
        if (view->nearest) {
          if (d2 >= view->nearest[start + column]) continue;
          view->nearest[start + column] = d2;
          image[start + column] = (unsigned char)grey;
        } else if (grey < (float)image[start + column]) image[start + column] = (unsigned char)grey;
      }
    }
  }
}

/* Slope of the curve at a node, by the parabola through it and its neighbours. */
static Pixel slope(Pixel before, Pixel at, Pixel after, double h0, double h1) {
  const double w0 = h1 / (h0 * (h0 + h1)), w1 = h0 / (h1 * (h0 + h1));
  return (Pixel){(at.u - before.u) * w0 + (after.u - at.u) * w1, (at.v - before.v) * w0 + (after.v - at.v) * w1};
}

/* Slope at one end of a link from that at the other, by the parabola through both nodes. */
static Pixel other_slope(Pixel a, Pixel b, Pixel known, double h) {
  return (Pixel){2 * (b.u - a.u) / h - known.u, 2 * (b.v - a.v) / h - known.v};
}

static void draw_link(const FluoroscopyView* view, Pixel a, Pixel b, Pixel slope_a, Pixel slope_b, double h,
                      unsigned char* image, unsigned char* mask) {
  const double length = hypot(b.u - a.u, b.v - a.v) / view->piece;
  const int pieces = length < MAX_PIECES ? (int)length + 1 : MAX_PIECES;
  Pixel from = a;
  for (int i = 1; i <= pieces; i++) {
    Pixel to = b;
    if (i < pieces) {
      const double t = (double)i / pieces, s = 1 - t;
      const double wa = s * s * (1 + 2 * t), wb = t * t * (1 + 2 * s), wsa = h * t * s * s, wsb = -h * s * t * t;
      to.u = wa * a.u + wb * b.u + wsa * slope_a.u + wsb * slope_b.u;
      to.v = wa * a.v + wb * b.v + wsa * slope_a.v + wsb * slope_b.v;
    }
    draw_piece(view, from, to, image, mask);
    from = to;
  }
}

/* Draws the smooth curve through n nodes (n x 3, m, world). The image (height x width) must already hold the
 * background and the mask zeros; either may be NULL. */
int cathsim_fluoroscopy_draw(const FluoroscopyView* view, int n, const double* nodes, unsigned char* image,
                             unsigned char* mask) {
  Pixel before = {0, 0}, a, b, after = {0, 0};
  int state;
  if (n < 2) return DRAWN;
  /* all nodes are checked first: a refused wire leaves the images as they were */
  for (int i = 0; i < n; i++)
    if ((state = project(view, nodes + 3 * i, &a)) != DRAWN) return state;

  project(view, nodes, &a);
  project(view, nodes + 3, &b);
  double h0 = 0, h1 = chord(nodes, nodes + 3), h2 = 0;
  for (int i = 0; i + 1 < n; i++) {
    const int has_before = i > 0, has_after = i + 2 < n;
    if (has_after) {
      project(view, nodes + 3 * (i + 2), &after);
      h2 = chord(nodes + 3 * (i + 1), nodes + 3 * (i + 2));
    }
    Pixel slope_a = {(b.u - a.u) / h1, (b.v - a.v) / h1}, slope_b = slope_a;
    if (has_before) slope_a = slope(before, a, b, h0, h1);
    if (has_after) slope_b = slope(a, b, after, h1, h2);
    if (!has_before && has_after) slope_a = other_slope(a, b, slope_b, h1);
    if (has_before && !has_after) slope_b = other_slope(a, b, slope_a, h1);
    draw_link(view, a, b, slope_a, slope_b, h1, image, mask);
    before = a, a = b, b = after, h0 = h1, h1 = h2;
  }
  return DRAWN;
}

typedef struct {
  double origin[3]; /* m, world */
  double spacing;   /* m */
  Lattice distance; /* signed distance to the wall, m, positive inside */
} DistanceGrid;

static double distance_at(const DistanceGrid* g, const double index[3]) {
  int base[3];
  double t[3];
  for (int k = 0; k < 3; k++) {
    const double limit = g->distance.size[k] - 1.000001, u = index[k] < 0 ? 0 : index[k] > limit ? limit : index[k];
    base[k] = (int)u;
    t[k] = u - base[k];
  }
  return lattice_interpolate(&g->distance, base, t);
}

/* Length (m) of the ray from `start` along the unit `direction` where the distance exceeds `level`. */
static double ray_length(const DistanceGrid* g, const double start[3], const double direction[3], double level) {
  double near = 0, far = HUGE_VAL, at[3], step[3];
  for (int k = 0; k < 3; k++) {
    at[k] = (start[k] - g->origin[k]) / g->spacing;
    step[k] = direction[k] / g->spacing;
    const double last = g->distance.size[k] - 1;
    if (fabs(step[k]) < 1e-12) {
      if (at[k] < 0 || at[k] > last) return 0;
      continue;
    }
    const double enter = -at[k] / step[k], leave = (last - at[k]) / step[k];
    near = fmax(near, fmin(enter, leave));
    far = fmin(far, fmax(enter, leave));
  }
  if (!(near < far)) return 0;

  double length = 0, t = near;
  double p[3] = {at[0] + t * step[0], at[1] + t * step[1], at[2] + t * step[2]};
  double value = distance_at(g, p) - level;
  while (t < far) {
    /* no wall lies nearer than |value|, give or take the grid's own error */
    const double advance = fmin(fmax(0.9 * fabs(value), 0.5 * g->spacing), far - t);
    t += advance;
    for (int k = 0; k < 3; k++) p[k] = at[k] + t * step[k];
    const double next = distance_at(g, p) - level;
    if (value > 0 && next > 0)
      length += advance;
    else if ((value > 0) != (next > 0))
      length += advance * (value > 0 ? value : next) / fabs(value - next);
    value = next;
    if (far - t < 1e-9) break;
  }
  return length;
}

/* Mean path length (m) through {distance > level} for every pixel (height x width), over samples x samples rays.
 * `ray` (3 x 3) turns a homogeneous pixel into a world direction. */
void cathsim_fluoroscopy_integrate(const DistanceGrid* grid, const double source[3], const double ray[9], double level,
                                   int width, int height, int samples, float* lengths) {
  for (int row = 0; row < height; row++) {
    for (int column = 0; column < width; column++) {
      double sum = 0;
      for (int i = 0; i < samples * samples; i++) {
        const double u = column + (i % samples + 0.5) / samples - 0.5, v = row + (i / samples + 0.5) / samples - 0.5;
        double d[3], norm = 0;
        for (int k = 0; k < 3; k++) {
          d[k] = ray[3 * k] * u + ray[3 * k + 1] * v + ray[3 * k + 2];
          norm += d[k] * d[k];
        }
        norm = sqrt(norm);
        for (int k = 0; k < 3; k++) d[k] /= norm;
        sum += ray_length(grid, source, d, level);
      }
      lengths[(size_t)row * width + column] = (float)(sum / (samples * samples));
    }
  }
}

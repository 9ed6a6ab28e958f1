/* A smooth curve in space through two images: Gauss-Newton on a uniform cubic B-spline (see curve_fitting.py).

   Unknowns are control points (x, y, z), of which four act at any place, so that all matrices are banded: element (j + k, j) of a
   symmetric matrix lies at 12 j + k. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { BAND = 12 };

struct Image {
    int count;
    const double *P;      /* (3, 4) mm to px */
    const double *points; /* (count, 2) px, annotated, tip first */
    double *along;        /* (count) mm, where on the curve each lies; updated */
    int tip;              /* whether the first point is the tip */
    double *off;          /* (count) px, out: signed distance of each from the projected curve */
};

struct Spline {
    int count;      /* control points */
    double pitch;   /* mm between knots */
    double *points; /* (count, 3) mm; updated */
    double *band;   /* (3 count, 12) mm^2, out: posterior covariance within the band */
};

struct Prior {
    double noise;              /* px; updated if it is to be estimated */
    double least_noise;        /* px */
    int estimate;              /* whether to estimate the noise */
    double outlier;            /* in noises, beyond which a point loses weight */
    double bending;            /* 1/mm, spectral density of the curvature */
    double bend;               /* 1/mm, curvature beyond which bending costs less */
    double changing;           /* 1/mm^3, the same of the curvature's change along the wire */
    double change;             /* 1/mm^2 */
    double speed;              /* how exactly the parameter is the arc length */
    int iterations;
    double freedom;            /* out: parameters that the data decide */
};

static int cell_of(double s, double h, int n, double *value, double *slope) {
    int i = (int)(s / h);
    if (i < 0) i = 0;
    if (i > n - 4) i = n - 4;
    double u = s / h - i, v = 1.0 - u;
    value[0] = v * v * v / 6, value[3] = u * u * u / 6;
    value[1] = (3 * u * u * u - 6 * u * u + 4) / 6, value[2] = (3 * v * v * v - 6 * v * v + 4) / 6;
    slope[0] = -v * v / (2 * h), slope[3] = u * u / (2 * h);
    slope[1] = (3 * u * u - 4 * u) / (2 * h), slope[2] = -(3 * v * v - 4 * v) / (2 * h);
    return i;
}

static void mixed(const double *c, int i, const double *weight, double *x) {
    for (int d = 0; d < 3; d++) {
        x[d] = 0;
        for (int k = 0; k < 4; k++) x[d] += weight[k] * c[3 * (i + k) + d];
    }
}

/* Adds the square of one residual, r + row . (12 unknowns from 3 i on), to the normal equations. */
static void add(double *H, double *g, int i, const double *row, double r) {
    for (int a = 0; a < BAND; a++) {
        double *column = H + (size_t)BAND * (3 * i + a);
        for (int b = a; b < BAND; b++) column[b - a] += row[a] * row[b];
        g[3 * i + a] += row[a] * r;
    }
}

/* Adds a heavy-tailed prior on the m-th differences of the control points. */
static void add_differences(double *H, double *g, const double *c, int n, double h, int m, double density, double knee) {
    static const double STENCIL[4][4] = {{1}, {-1, 1}, {1, -2, 1}, {-1, 3, -3, 1}};
    const double *w = STENCIL[m];
    for (int i = 0; i + m < n; i++) {
        double d[3] = {0, 0, 0}, size = 0, unit = pow(h, -m);
        for (int k = 0; k <= m; k++)
            for (int e = 0; e < 3; e++) d[e] += w[k] * c[3 * (i + k) + e];
        for (int e = 0; e < 3; e++) size += d[e] * d[e] * unit * unit;
        double weight = h * unit * unit / density / (1 + size / (knee * knee));
        for (int k = 0; k <= m; k++)
            for (int e = 0; e < 3; e++) {
                g[3 * (i + k) + e] += weight * w[k] * d[e];
                for (int l = k; l <= m; l++) H[(size_t)BAND * (3 * (i + k) + e) + 3 * (l - k)] += weight * w[k] * w[l];
            }
    }
}

/* Cholesky in place; 0 where the matrix is not positive. */
static int factor(double *L, int size) {
    for (int j = 0; j < size; j++) {
        double *column = L + (size_t)BAND * j;
        if (!(column[0] > 0)) return 0;
        double root = sqrt(column[0]);
        for (int k = 0; k < BAND; k++) column[k] /= root;
        for (int k = 1; k < BAND && j + k < size; k++)
            for (int l = k; l < BAND; l++) L[(size_t)BAND * (j + k) + l - k] -= column[k] * column[l];
    }
    return 1;
}

static void solve(const double *L, int size, double *x) {
    for (int j = 0; j < size; j++) {
        x[j] /= L[(size_t)BAND * j];
        for (int k = 1; k < BAND && j + k < size; k++) x[j + k] -= L[(size_t)BAND * j + k] * x[j];
    }
    for (int j = size - 1; j >= 0; j--) {
        for (int k = 1; k < BAND && j + k < size; k++) x[j] -= L[(size_t)BAND * j + k] * x[j + k];
        x[j] /= L[(size_t)BAND * j];
    }
}

/* The inverse within the band, by Takahashi's recursion. */
static void invert(const double *L, int size, double *V) {
    memset(V, 0, sizeof(double) * BAND * size);
    for (int j = size - 1; j >= 0; j--) {
        const double *column = L + (size_t)BAND * j;
        for (int k = BAND - 1; k >= 0; k--) {
            if (j + k >= size) continue;
            double sum = k == 0 ? 1 / column[0] : 0;
            for (int l = 1; l < BAND && j + l < size; l++) {
                int low = k < l ? k : l, high = k < l ? l : k;
                sum -= column[l] * (k == 0 ? V[(size_t)BAND * j + l] : V[(size_t)BAND * (j + low) + high - low]);
            }
            V[(size_t)BAND * j + k] = sum / column[0];
        }
    }
}

struct Look { double x[2], turn[2], jacobian[2][3]; };

static int look(const struct Image *image, const struct Spline *spline, double s, double *value, struct Look *seen) {
    double slope[4], X[3], T[3], p[3];
    int i = cell_of(s, spline->pitch, spline->count, value, slope);
    mixed(spline->points, i, value, X);
    mixed(spline->points, i, slope, T);
    const double *P = image->P;
    for (int a = 0; a < 3; a++) p[a] = P[4 * a] * X[0] + P[4 * a + 1] * X[1] + P[4 * a + 2] * X[2] + P[4 * a + 3];
    for (int a = 0; a < 2; a++) {
        seen->x[a] = p[a] / p[2];
        seen->turn[a] = 0;
        for (int d = 0; d < 3; d++) {
            seen->jacobian[a][d] = (P[4 * a + d] - seen->x[a] * P[8 + d]) / p[2];
            seen->turn[a] += seen->jacobian[a][d] * T[d];
        }
    }
    return i;
}

static void direction_row(
    const struct Look *seen, const double *direction, const double *value, double weight, double *row) {
    for (int k = 0; k < 4; k++)
        for (int d = 0; d < 3; d++)
            row[3 * k + d] =
                weight * value[k] * (direction[0] * seen->jacobian[0][d] + direction[1] * seen->jacobian[1][d]);
}

/* Adds an image's residuals; returns the sum of weighted squares (px^2) and adds the weights to *total. */
static double add_image(
    struct Image *image, const struct Spline *spline, const struct Prior *prior, int move, double *H, double *g,
    double *total) {
    const double end = spline->pitch * (spline->count - 3);
    double squares = 0, row[BAND], value[4];
    for (int k = 0; k < image->count; k++) {
        const double *y = image->points + 2 * k;
        struct Look seen;
        double s = image->along[k];
        int fixed = k == 0 && image->tip;
        if (fixed) s = 0;
        else
            for (int turn = 0; turn < move; turn++) {
                look(image, spline, s < 0 ? 0 : s > end ? end : s, value, &seen);
                double rate = seen.turn[0] * seen.turn[0] + seen.turn[1] * seen.turn[1];
                double step = ((y[0] - seen.x[0]) * seen.turn[0] + (y[1] - seen.x[1]) * seen.turn[1]) / rate;
                double most = 0.5 * spline->pitch;
                s += step > most ? most : step < -most ? -most : step;
                s = s < 0 ? 0 : s > end + 1 ? end + 1 : s;
            }
        image->along[k] = s;
        int i = look(image, spline, s > end ? end : s, value, &seen);
        double norm = sqrt(seen.turn[0] * seen.turn[0] + seen.turn[1] * seen.turn[1]);
        double tangent[2] = {seen.turn[0] / norm, seen.turn[1] / norm}, normal[2] = {-tangent[1], tangent[0]};
        double e[2] = {seen.x[0] - y[0], seen.x[1] - y[1]};
        double r = normal[0] * e[0] + normal[1] * e[1];
        image->off[k] = r;
        if (s > end) continue;
        double trust = 1 / (1 + pow(r / (prior->outlier * prior->noise), 2));
        double weight = sqrt(trust) / prior->noise;
        direction_row(&seen, normal, value, weight, row);
        add(H, g, i, row, r * weight);
        squares += trust * r * r;
        *total += trust;
        if (fixed) { /* the tip is a point, the others say only that the curve passes */
            r = tangent[0] * e[0] + tangent[1] * e[1];
            weight = 1 / prior->noise;
            direction_row(&seen, tangent, value, weight, row);
            add(H, g, i, row, r * weight);
            squares += r * r;
            *total += 1;
        }
    }
    return squares;
}

/* Fits the curve; returns the number of iterations, or -1 without memory or for a matrix that is not positive. */
int guide3d_fit(struct Image *images, struct Spline *spline, struct Prior *prior) {
    const int n = spline->count, size = 3 * n;
    const double h = spline->pitch;
    double *c = spline->points, *V = spline->band;
    size_t bytes = sizeof(double) * BAND * size;
    double *H = malloc(bytes), *data = malloc(bytes), *g = malloc(sizeof(double) * size);
    int iteration = -1, settled = 0;
    if (!H || !data || !g) goto done;
    for (iteration = 0; iteration <= prior->iterations; iteration++) {
        memset(H, 0, bytes);
        memset(g, 0, sizeof(double) * size);
        double squares = 0, total = 0;
        for (int v = 0; v < 2; v++) squares += add_image(images + v, spline, prior, iteration ? 2 : 0, H, g, &total);
        memcpy(data, H, bytes);
        for (int i = 0; i < n - 3; i++) {
            double value[4], slope[4], T[3], row[BAND];
            cell_of((i + 0.5) * h, h, n, value, slope);
            mixed(c, i, slope, T);
            double rate = sqrt(T[0] * T[0] + T[1] * T[1] + T[2] * T[2]), weight = sqrt(h) / prior->speed;
            for (int k = 0; k < 4; k++)
                for (int d = 0; d < 3; d++) row[3 * k + d] = weight * slope[k] * T[d] / rate;
            add(H, g, i, row, weight * (rate - 1));
        }
        add_differences(H, g, c, n, h, 2, prior->bending, prior->bend);
        add_differences(H, g, c, n, h, 3, prior->changing, prior->change);
        for (int j = 0; j < size; j++) {
            H[(size_t)BAND * j] += 1e-9;
            for (int k = size - j; k < BAND; k++) H[(size_t)BAND * j + k] = 0;
        }
        if (!factor(H, size)) {
            iteration = -1;
            break;
        }
        int last = settled || iteration == prior->iterations;
        if (last || (iteration >= 4 && iteration % 3 == 1)) {
            invert(H, size, V);
            prior->freedom = 0;
            for (int j = 0; j < size; j++)
                for (int k = 0; k < BAND && j + k < size; k++)
                    prior->freedom += (k ? 2 : 1) * V[(size_t)BAND * j + k] * data[(size_t)BAND * j + k];
            if (prior->estimate && !last) {
                double left = total - prior->freedom;
                if (left < 0.1 * total) left = 0.1 * total;
                prior->noise = sqrt(squares / left);
                if (prior->noise < prior->least_noise) prior->noise = prior->least_noise;
            }
        }
        if (last) break;
        solve(H, size, g);
        double largest = 0;
        for (int j = 0; j < size; j++)
            if (fabs(g[j]) > largest) largest = fabs(g[j]);
        double share = largest > 5 ? 5 / largest : 1;
        for (int j = 0; j < size; j++) c[j] -= share * g[j];
        /* the noise is estimated at 4, 7, 10: what settles before has not seen it */
        settled = iteration >= 8 && largest < 2e-3;
    }
done:
    free(H);
    free(data);
    free(g);
    return iteration;
}

/* Global monotone matching of two images of one curve by dynamic programming (see matching.py). */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

/* Moves along both curves. Those of 1:2 and 1:3 let a foreshortened stretch be crossed at its own rate: with unit moves
   alone, the path would be a staircase and its length in space that of the stairs. */
static const int MOVES[][2] = {{1, 1}, {1, 0}, {0, 1}, {1, 2}, {2, 1}, {1, 3}, {3, 1}};
enum { MOVE_COUNT = 7, ROWS = 4, START = 255, NONE = 254 };

struct View {
    int count;
    const double *angle;         /* (count) rad, epipolar plane of each sample */
    const double *slope_squared; /* (count) rad^2/px^2 */
    const double *rays;          /* (count, 3) unit directions */
    const double *source;        /* (3) mm */
};

struct Weights {
    double spacing;  /* px between samples */
    double match;    /* px, epipolar distance at which a px matched costs as much as one left out */
    double reach;    /* px, largest epipolar distance that a path may cross */
    double noise;    /* px, epipolar distance that costs one unit a px */
    double length;   /* cost of a mm in space */
    double uneven;   /* cost of a px by which one image is walked faster than the other */
    double start;    /* px from both tips within which a match may begin */
};

/* Middle of the shortest segment between two rays. */
static void between_rays(const double *p, const double *u, const double *q, const double *v, double *x) {
    double w[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
    double uv = u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
    double uw = u[0] * w[0] + u[1] * w[1] + u[2] * w[2];
    double vw = v[0] * w[0] + v[1] * w[1] + v[2] * w[2];
    double det = 1.0 - uv * uv;
    double s = (uw - uv * vw) / det, t = (uv * uw - vw) / det;
    for (int k = 0; k < 3; k++) x[k] = 0.5 * (p[k] + s * u[k] + q[k] + t * v[k]);
}

/* Writes the best path as pairs of sample numbers, tip first; returns its number of pairs, 0 if nothing matches, -1 without
   memory. path: room for 2 (a->count + b->count) numbers; squares: px^2 px, its cost but for the length in space. */
int guide3d_match(
    const struct View *a, const struct View *b, const struct Weights *weights, int32_t *path, double *squares) {
    const int n = a->count, m = b->count;
    const double reach2 = weights->reach * weights->reach, match2 = weights->match * weights->match;
    const double scale = 1.0 / (weights->noise * weights->noise);
    const int first = (int)(weights->start / weights->spacing);
    const double left = match2 * scale * weights->spacing;
    uint8_t *moves = malloc((size_t)n * m);
    double *cost = malloc(sizeof(double) * ROWS * m);
    double *points = malloc(sizeof(double) * 3 * ROWS * m);
    int count = -1;
    if (!moves || !cost || !points) goto done;
    double best = INFINITY;
    int best_i = -1, best_j = -1;
    for (int i = 0; i < n; i++) {
        double *row = cost + (size_t)(i % ROWS) * m, *x = points + (size_t)(i % ROWS) * 3 * m;
        for (int j = 0; j < m; j++) {
            double off = a->angle[i] - b->angle[j];
            double distance2 = off * off / (a->slope_squared[i] + b->slope_squared[j]);
            moves[(size_t)i * m + j] = NONE;
            row[j] = INFINITY;
            if (distance2 >= reach2) continue;
            between_rays(a->source, a->rays + 3 * i, b->source, b->rays + 3 * j, x + 3 * j);
            double miss = distance2 * scale * weights->spacing;
            double least = INFINITY;
            if (i <= first && j <= first) least = miss + (i + j) * left;
            int chosen = least < INFINITY ? START : NONE;
            for (int k = 0; k < MOVE_COUNT; k++) {
                int di = MOVES[k][0], dj = MOVES[k][1];
                if (di > i || dj > j) continue;
                double before = cost[(size_t)((i - di) % ROWS) * m + j - dj];
                if (before == INFINITY) continue;
                const double *y = points + ((size_t)((i - di) % ROWS) * m + j - dj) * 3;
                double dx = x[3 * j] - y[0], dy = x[3 * j + 1] - y[1], dz = x[3 * j + 2] - y[2];
                double candidate = before + 0.5 * (di + dj) * miss;
                candidate += weights->uneven * weights->spacing * abs(di - dj);
                candidate += weights->length * sqrt(dx * dx + dy * dy + dz * dz);
                if (candidate < least) least = candidate, chosen = k;
            }
            row[j] = least;
            moves[(size_t)i * m + j] = (uint8_t)chosen;
            /* a wire is matched when one of its images is used up; where both go on, what is left of the shorter costs */
            double whole = least + left * (n - 1 - i < m - 1 - j ? n - 1 - i : m - 1 - j);
            if (whole < best) best = whole, best_i = i, best_j = j;
        }
    }
    *squares = 0.0;
    count = 0;
    if (best_i < 0) goto done;
    int rest = n - 1 - best_i < m - 1 - best_j ? n - 1 - best_i : m - 1 - best_j;
    *squares = rest * match2 * weights->spacing;
    for (int i = best_i, j = best_j;;) {
        path[2 * count] = i, path[2 * count + 1] = j, count++;
        int k = moves[(size_t)i * m + j];
        double off = a->angle[i] - b->angle[j];
        double distance2 = off * off / (a->slope_squared[i] + b->slope_squared[j]);
        if (k == START) {
            *squares += (distance2 + (i + j) * match2) * weights->spacing;
            break;
        }
        *squares += 0.5 * (MOVES[k][0] + MOVES[k][1]) * distance2 * weights->spacing;
        i -= MOVES[k][0], j -= MOVES[k][1];
    }
    for (int k = 0; k < count / 2; k++)
        for (int c = 0; c < 2; c++) {
            int32_t swap = path[2 * k + c];
            path[2 * k + c] = path[2 * (count - 1 - k) + c];
            path[2 * (count - 1 - k) + c] = swap;
        }
done:
    free(moves);
    free(cost);
    free(points);
    return count;
}

#ifdef GUIDE3D_SOURCES
const char *guide3d_sources(void) { return GUIDE3D_SOURCES; }
#endif

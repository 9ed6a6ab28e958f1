/* Blocks of a lattice, from the nodes of its own that each occupied block has, and values between their nodes
 * (lattice/node_blocks.py).
 *
 * Values of nodes are compared and copied as four bytes, whatever they mean. `blocks` are numbers of blocks along x, y and z;
 * `numbers` gives, for each block, z running fastest, where its own nodes stand in `cores`, -1 where it has none. */
#include <math.h>
#include <string.h>

#include "lattice.h"

enum { EDGE = 8, SIDE = 10, CORE = EDGE * EDGE * EDGE };

static size_t block_at(const int32_t blocks[3], int i, int j, int k) {
  return ((size_t)i * blocks[1] + j) * blocks[2] + k;
}

/* The own nodes of a block; NULL beyond the lattice, and where all hold the constant. */
static const uint32_t* core_at(const int32_t blocks[3], const int32_t* numbers, const uint32_t* cores, int i, int j,
                               int k) {
  if (i < 0 || j < 0 || k < 0 || i >= blocks[0] || j >= blocks[1] || k >= blocks[2]) return NULL;
  const int32_t number = numbers[block_at(blocks, i, j, k)];
  return number < 0 ? NULL : cores + (size_t)number * CORE;
}

/* Whether the block's first (-1), last (1) or any (0) nodes along each axis hold more than the constant, given whether
 * those that are first, in between or last do. */
static int reaches(const uint8_t differs[3][3][3], const int step[3]) {
  for (int x = 0; x < 3; x++)
    for (int y = 0; y < 3; y++)
      for (int z = 0; z < 3; z++)
        if (differs[x][y][z] && (!step[0] || x == step[0] + 1) && (!step[1] || y == step[1] + 1) &&
            (!step[2] || z == step[2] + 1))
          return 1;
  return 0;
}

/* Marks in `stored` the blocks with a node that is not the constant, among their own or those next to them. */
void cathsim_mark_blocks(const int32_t blocks[3], const int32_t* numbers, const uint32_t* cores, uint32_t constant,
                         uint8_t* stored) {
  static const uint8_t kind[EDGE] = {0, 1, 1, 1, 1, 1, 1, 2};
  for (int i = 0; i < blocks[0]; i++)
    for (int j = 0; j < blocks[1]; j++)
      for (int k = 0; k < blocks[2]; k++) {
        const uint32_t* node = core_at(blocks, numbers, cores, i, j, k);
        if (!node) continue;
        uint8_t differs[3][3][3] = {{{0}}};
        for (int x = 0; x < EDGE; x++)
          for (int y = 0; y < EDGE; y++)
            for (int z = 0; z < EDGE; z++, node++) differs[kind[x]][kind[y]][kind[z]] |= *node != constant;
        for (int step = 0; step < 27; step++) {
          const int to[3] = {step / 9 - 1, step / 3 % 3 - 1, step % 3 - 1};
          const int there[3] = {i + to[0], j + to[1], k + to[2]};
          const int within = there[0] >= 0 && there[1] >= 0 && there[2] >= 0 && there[0] < blocks[0] &&
                             there[1] < blocks[1] && there[2] < blocks[2];
          if (within && reaches(differs, to)) stored[block_at(blocks, there[0], there[1], there[2])] = 1;
        }
      }
}

/* Fills the nodes of the stored blocks, those of `table`, with their own and with copies of those next to them. */
void cathsim_fill_blocks(const int32_t blocks[3], const int32_t* numbers, const int32_t* table, const uint32_t* cores,
                         uint32_t constant, uint32_t* nodes) {
  for (int n = 0; n < NODES; n++) nodes[n] = constant;
  for (int i = 0; i < blocks[0]; i++)
    for (int j = 0; j < blocks[1]; j++)
      for (int k = 0; k < blocks[2]; k++) {
        const int32_t block = table[block_at(blocks, i, j, k)];
        if (!block) continue;
        uint32_t* row = nodes + (size_t)block * NODES;
        for (int x = 0; x < SIDE; x++)
          for (int y = 0; y < SIDE; y++, row += SIDE) {
            const int di = x == 0 ? -1 : x == SIDE - 1, dj = y == 0 ? -1 : y == SIDE - 1;
            const size_t first = (size_t)((x - 1) & (EDGE - 1)) * EDGE * EDGE + (size_t)((y - 1) & (EDGE - 1)) * EDGE;
            const uint32_t* before = core_at(blocks, numbers, cores, i + di, j + dj, k - 1);
            const uint32_t* own = core_at(blocks, numbers, cores, i + di, j + dj, k);
            const uint32_t* after = core_at(blocks, numbers, cores, i + di, j + dj, k + 1);
            row[0] = before ? before[first + EDGE - 1] : constant;
            row[SIDE - 1] = after ? after[first] : constant;
            if (own)
              memcpy(row + 1, own + first, EDGE * sizeof(uint32_t));
            else
              for (int z = 1; z <= EDGE; z++) row[z] = constant;
          }
      }
}

/* Trilinear interpolation at `count` fractional indices (count x 3), clamped to the lattice; not a number gives that. */
void cathsim_interpolate(const Lattice* l, int64_t count, const double* index, double* values) {
  for (int64_t n = 0; n < count; n++, index += 3) {
    int base[3];
    double t[3], value = 0;
    for (int i = 0; i < 3; i++) {
      const double limit = l->size[i] - 1;
      const double u = index[i] < 0 ? 0 : index[i] > limit ? limit : index[i];
      base[i] = u < limit ? (int)u : l->size[i] - 2;
      t[i] = u - base[i];
    }
    if (isnan(t[0]) || isnan(t[1]) || isnan(t[2])) {
      values[n] = NAN;
      continue;
    }
    const float* corner = lattice_node(l, base[0], base[1], base[2]);
    for (int x = 0; x < 2; x++)
      for (int y = 0; y < 2; y++) {
        const float* c = corner + x * NODE_X + y * NODE_Y;
        const double weight = (x ? t[0] : 1 - t[0]) * (y ? t[1] : 1 - t[1]);
        value += weight * ((double)c[0] * (1 - t[2]) + (double)c[NODE_Z] * t[2]);
      }
    values[n] = value;
  }
}

/* The model; see dlgmd.h. Its constants and sums are in dlgmd_model.h. */
#include "dlgmd.h"

#include <string.h>

enum {
    WIDTH = DLGMD_WIDTH,
    HEIGHT = DLGMD_HEIGHT,
    CELLS = DLGMD_WIDTH * DLGMD_HEIGHT,
    RADIUS = DLGMD_RADIUS,
    ROWS = DLGMD_ROWS,
    DELAYS = DLGMD_MAX_DELAY + 1
};

/* Where to read the change of a frame: the first row that the kernels reach. */
typedef struct {
    const uint8_t *change;
#if DLGMD_CONTRAST
    const dlgmd_change *passed; /* P' by change */
#endif
} source;

#include "dlgmd_model.h"

#if DLGMD_FIXED
typedef uint32_t number;
typedef uint64_t total; /* 64 bits are used per row or per frame, never per cell */
#else
typedef float number;
typedef float total;
#endif

/* Sums over the rows so far: G, and G times its column and its row. */
typedef struct {
    total g;
    total g_column;
    total g_row;
#if DLGMD_BALANCE
    total quadrants[4]; /* G of each: top left and right, bottom left and right */
#endif
    total mp; /* K, in the unit of `g` */
} totals;

void dlgmd_reset(dlgmd_state *state)
{
    memset(state, 0, sizeof *state);
}

static uint8_t distance(uint8_t a, uint8_t b)
{
    return (uint8_t)(a < b ? b - a : a - b);
}

/* Row `at` of the ring. */
static uint8_t *ring_row(dlgmd_state *state, int at)
{
    return state->change + DLGMD_MARGIN + at * DLGMD_STRIDE;
}

/* Store the change of row `y`, zeros below the frame, and return its sum. */
static uint32_t see_row(dlgmd_state *state, const uint8_t *frame, int y)
{
    int at = ((int)state->start + RADIUS + y) % ROWS;
    uint8_t *row = ring_row(state, at);
    uint32_t sum = 0;
    if (y < HEIGHT) {
        const uint8_t *now = frame + y * WIDTH;
        uint8_t *before = state->previous + y * WIDTH;
        for (int x = 0; x < WIDTH; x++) {
            row[x] = distance(now[x], before[x]);
            before[x] = now[x];
            sum += row[x];
        }
    } else {
        memset(row, 0, WIDTH);
    }
    if (at < 2 * RADIUS) {
        memcpy(ring_row(state, at + ROWS), row, WIDTH);
    }
    return sum;
}

/* S of row `y`. */
static void sum_row(dlgmd_state *state, int y, dlgmd_sum *s)
{
    source sources[DELAYS];
    for (int delay = 0; delay < DELAYS; delay++) {
        int at = (int)state->start + ROWS + y - delay * DLGMD_PERIOD;
        sources[delay].change = ring_row(state, at % ROWS);
#if DLGMD_CONTRAST
        sources[delay].passed = state->passed[(state->frame - (uint32_t)delay) % DELAYS];
#endif
    }
    sum_columns(sources, state->work.rows.columns);
    sum_along(sources, state->work.rows.columns, s);
}

#if DLGMD_CONTRAST

#if DLGMD_FIXED

/* The interval in 1/2^20 s, and in frames at the usual rate, in 1/65536. */
static void see_time(dlgmd_state *state, uint32_t step_ms)
{
    step_ms = step_ms < MAX_STEP_MS ? step_ms : MAX_STEP_MS;
    state->interval = step_ms ? ((step_ms << 17) + 62) / 125 : USUAL_INTERVAL;
    state->n_usual = (uint32_t)((uint64_t)state->interval * USUAL_FPS >> 20);
    state->n_usual = USUAL_FPS && step_ms ? state->n_usual : 65536;
}

/* 1 - exp(-x): the share that the newest value has in a mean. `x` is in 1/2^24, the share in 1/32768. */
static int32_t share_of(uint64_t x)
{
    unsigned n_halved = 0;
    for (; x > 1 << 20; x >>= 1) {
        n_halved++;
    }
    uint64_t share = x - (x * x >> 25) + (x * x / 6 >> 24) * x / (1 << 24);
    for (; n_halved > 0; n_halved--) {
        share = 2 * share - (share * share >> 24);
    }
    return (int32_t)((share + 256) >> 9);
}

#if DLGMD_ADAPTS || DLGMD_EXPANDS
/* The same after the interval of this frame, for a rate per second in 1/65536. */
static int32_t newest_of(const dlgmd_state *state, uint32_t rate)
{
    return share_of((uint64_t)state->interval * rate >> 12);
}
#endif

/* The same, for a rate per usual frame in 1/2^24. */
static int32_t newest_of_frames(const dlgmd_state *state, uint32_t rate)
{
    return share_of((uint64_t)state->n_usual * rate >> 16);
}

#else

/* The interval in seconds, and in frames at the usual rate. */
static void see_time(dlgmd_state *state, uint32_t step_ms)
{
    step_ms = step_ms < MAX_STEP_MS ? step_ms : MAX_STEP_MS;
    state->interval = step_ms ? 0.001f * (float)step_ms : USUAL_INTERVAL;
    state->n_usual = USUAL_FPS > 0.0f && step_ms ? state->interval * USUAL_FPS : 1.0f;
}

/* 1 - exp(-x): the share that the newest value has in a mean. */
static float share_of(float x)
{
    unsigned n_halved = 0;
    for (; x > 0.125f; x *= 0.5f) {
        n_halved++;
    }
    float share = x * (1.0f - x / 2.0f * (1.0f - x / 3.0f * (1.0f - x / 4.0f * (1.0f - x / 5.0f))));
    for (; n_halved > 0; n_halved--) {
        share *= 2.0f - share;
    }
    return share;
}

#if DLGMD_ADAPTS || DLGMD_EXPANDS
/* The same after the interval of this frame, for a rate per second. */
static float newest_of(const dlgmd_state *state, float rate)
{
    return share_of(state->interval * rate);
}
#endif

/* The same, for a rate per usual frame. */
static float newest_of_frames(const dlgmd_state *state, float rate)
{
    return share_of(state->n_usual * rate);
}

#endif

#endif

#if DLGMD_SHIFT > 0

enum { BLOCKS_Y = DLGMD_HEIGHT / 4, BLOCKS_X = DLGMD_WIDTH / 4 };

static int size_of(int a)
{
    return a < 0 ? -a : a;
}

/* The smallest shift that is too large along a side of `n` blocks. */
static int limit_of(int n)
{
    return (n / 3 < DLGMD_SHIFT / 4 ? n / 3 : DLGMD_SHIFT / 4) + 1;
}

/* A mean as a fraction. */
typedef struct {
    uint64_t sum, of;
} fraction;

static bool is_less(fraction a, fraction b)
{
    return a.sum * b.of < b.sum * a.of;
}

/* Sums over whole blocks of 4 x 4 cells. */
static void see_blocks(uint16_t (*blocks)[BLOCKS_X], const uint8_t *frame)
{
    for (int y = 0; y < BLOCKS_Y; y++) {
        for (int x = 0; x < BLOCKS_X; x++) {
            const uint8_t *cell = frame + 4 * y * WIDTH + 4 * x;
            uint32_t sum = 0;
            for (int i = 0; i < 4; i++) {
                sum += (uint32_t)cell[0] + cell[1] + cell[2] + cell[3];
                cell += WIDTH;
            }
            blocks[y][x] = (uint16_t)sum;
        }
    }
}

/* Mean change of the blocks where both frames overlap, the earlier one moved. */
static fraction change_of_blocks(const dlgmd_state *state, int dy, int dx)
{
    fraction change = {0, 0};
    for (int y = dy > 0 ? dy : 0; y < BLOCKS_Y + (dy < 0 ? dy : 0); y++) {
        const uint16_t *now = state->work.blocks[0][y], *then = state->work.blocks[1][y - dy];
        uint32_t sum = 0;
        for (int x = dx > 0 ? dx : 0; x < BLOCKS_X + (dx < 0 ? dx : 0); x++) {
            sum += (uint32_t)size_of(now[x] - then[x - dx]);
        }
        change.sum += sum;
    }
    change.of = (uint64_t)((BLOCKS_Y - size_of(dy)) * (BLOCKS_X - size_of(dx)));
    return change;
}

typedef struct {
    int64_t run, rise;
} slope;

/* Twice the distance, in blocks, from here to the least change, by the changes beside: run / rise. */
static slope slope_of(fraction less, fraction here, fraction more)
{
    int64_t a = (int64_t)(less.sum * here.of * more.of), b = (int64_t)(here.sum * less.of * more.of);
    int64_t c = (int64_t)(more.sum * less.of * here.of), rise = (a > c ? a : c) - b;
    if (rise <= 0 || here.sum == 0 || less.of == 0 || more.of == 0) {
        return (slope){0, 1};
    }
    return (slope){a - c > rise ? rise : a - c < -rise ? -rise : a - c, rise};
}

/* Cells of a shift in blocks, by the change at one block less, there, and at one more. */
static int cells_of(int blocks, fraction less, fraction here, fraction more)
{
    slope part = slope_of(less, here, more);
    return 4 * blocks + (int)((4 * part.run + 9 * part.rise) / (2 * part.rise)) - 4; /* halves go up */
}

#if DLGMD_EXPANDS

enum {
    FACTOR = DLGMD_FACTOR,
    SMALL_Y = DLGMD_HEIGHT / DLGMD_FACTOR,
    SMALL_X = DLGMD_WIDTH / DLGMD_FACTOR,
    SIDE = (SMALL_Y < SMALL_X ? SMALL_Y : SMALL_X) / 2,
    LEAST_REACH = SIDE < 12 ? (SIDE + 1) / 2 : 6,
    LINE = DLGMD_WINDOW + 2 /* cells in a row of the earlier picture that are kept */
};

typedef struct {
    int top, bottom, left, right; /* rows and columns; those of `bottom` and `right` are excluded */
} window;

/* Sum of the cells of three blocks, one below the other. */
static uint32_t column_of(const uint8_t *const *blocks, int x)
{
    uint32_t sum = 0;
    for (int i = 0; i < FACTOR; i++) {
        for (int at = i * WIDTH + x * FACTOR; at < i * WIDTH + (x + 1) * FACTOR; at++) {
            sum += (uint32_t)blocks[0][at] + blocks[1][at] + blocks[2][at];
        }
    }
    return sum;
}

/* A part of row `y` of the reduced picture: means over blocks, and over 3 x 3 of those; at a border,
   the blocks next to it count twice. */
static void reduce(const uint8_t *frame, int y, int left, int right, uint8_t *row)
{
    const uint8_t *blocks[3];
    for (int i = 0; i < 3; i++) {
        int at = y + i - 1;
        blocks[i] = frame + (at < 0 ? 0 : at < SMALL_Y ? at : SMALL_Y - 1) * FACTOR * WIDTH;
    }
    const uint32_t of = 9 * FACTOR * FACTOR;
    uint32_t now = column_of(blocks, left), before = left > 0 ? column_of(blocks, left - 1) : now;
    for (int x = left + 1; x < (right < SMALL_X ? right + 1 : SMALL_X); x++) {
        uint32_t next = column_of(blocks, x);
        *row++ = (uint8_t)((before + now + next + of / 2) / of);
        before = now;
        now = next;
    }
    if (right == SMALL_X) {
        *row = (uint8_t)((before + 2 * now + of / 2) / of);
    }
}

#if DLGMD_FIXED

/* A difference in 1/32 of a grey level. */
typedef int32_t rest;
typedef int64_t moment;

/* Of a motion; of a variance; of a change. */
#define ONE (INT64_C(1) << 24)
#define MOMENT 256
#define CHANGE 16

/* A share in 1/32768 of a motion. */
static dlgmd_motion part_of(dlgmd_motion all, int32_t share)
{
    return all * share >> 15;
}

/* A rate per frame as one per second, within the limits. */
static dlgmd_motion per_second(const dlgmd_state *state, dlgmd_motion rate)
{
    int64_t interval = state->interval, most = MAX_RATE * interval >> 20;
    return (rate < -most ? -most : rate < most ? rate : most) * (INT64_C(1) << 20) / interval;
}

/* What a cell at `offset` halves from the middle, at `from` halves, moves to. */
static dlgmd_place place_of(int from, int offset, dlgmd_motion shift, dlgmd_motion rate)
{
    return (dlgmd_place)(((int64_t)(from + offset) * 128) + ((shift + rate * offset / 2 + 32768) >> 16));
}

static int cell_of(dlgmd_place at)
{
    return at >> 8;
}

/* value / 2^bits, rounded */
static int32_t shifted(int32_t value, unsigned bits)
{
    return (value + (1 << (bits - 1))) >> bits;
}

/* How far a place is from the cell before it. */
static dlgmd_place beyond(dlgmd_place at)
{
    return at & 255;
}

/* What is between two cells, `part` of the way from the first one. */
static dlgmd_blend between(int32_t first, int32_t second, dlgmd_place part)
{
    return (dlgmd_blend)(256 * first + part * (second - first));
}

/* A cell less what is between two others. */
static rest rest_of(int32_t cell, dlgmd_blend left, dlgmd_blend right, dlgmd_place part)
{
    return shifted(65536 * cell - 256 * left - part * (right - left), 11);
}

static rest slope_in_levels(int32_t sobel)
{
    return 4 * sobel;
}

/* 1 / (1 + (apart / scale)^2), in 1/256. */
static int32_t weight_of(rest apart, rest scale)
{
    for (; scale >= 512; scale /= 2) {
        apart /= 2; /* so that 32 bits are enough */
    }
    uint32_t square = (uint32_t)(scale * scale);
    return (int32_t)((square << 8) / (square + (uint32_t)(apart * apart)));
}

/* One and a half times the mean difference, and a grey level. */
static rest scale_of(moment sum, int n)
{
    return (rest)(3 * sum / (2 * n)) + 32;
}

/* Solve for the motion, which is added. The places in the sums are in halves of a cell. */
static void solve(moment m[4][5], dlgmd_motion *found)
{
    int64_t q[4];
    unsigned shift[4];
    for (int i = 0; i < 4; i++) {
        m[i][i] += (m[i][i] >> 20) + (i < 2 ? 262 : 104858);
        for (shift[i] = 0; m[i][i] >> 2 * shift[i] >= INT64_C(1) << 30; shift[i]++) {
        }
    }
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            m[i][j] >>= shift[i] + shift[j];
        }
        m[i][4] >>= shift[i];
    }
    for (int k = 0; k < 4; k++) {
        m[k][k] = m[k][k] > 0 ? m[k][k] : 1;
        for (int i = k + 1; i < 4; i++) {
            int64_t factor = m[i][k] * 4096 / m[k][k];
            for (int j = k; j < 5; j++) {
                m[i][j] -= factor * m[k][j] >> 12;
            }
        }
    }
    for (int k = 3; k >= 0; k--) {
        int64_t sum = m[k][4] * 65536;
        for (int j = k + 1; j < 4; j++) {
            sum -= m[k][j] * q[j];
        }
        q[k] = sum / m[k][k];
        found[k] += (k < 2 ? 256 * q[k] : 512 * q[k]) >> shift[k];
    }
}

#else

typedef float rest;
typedef float moment;

#define ONE 1.0f
#define MOMENT 1.0f
#define CHANGE 1.0f

static dlgmd_motion part_of(dlgmd_motion all, float share)
{
    return all * share;
}

/* A rate per frame as one per second, within the limits. */
static dlgmd_motion per_second(const dlgmd_state *state, dlgmd_motion rate)
{
    rate /= state->interval;
    return rate < -MAX_RATE ? -MAX_RATE : rate < MAX_RATE ? rate : MAX_RATE;
}

static dlgmd_place place_of(int from, int offset, dlgmd_motion shift, dlgmd_motion rate)
{
    return 0.5f * (float)from + shift + (1.0f + rate) * (0.5f * (float)offset);
}

static int cell_of(dlgmd_place at)
{
    return (int)at;
}

/* How far a place is from the cell before it. */
static dlgmd_place beyond(dlgmd_place at)
{
    int cell = cell_of(at);
    return at - (float)cell;
}

/* What is between two cells, `part` of the way from the first one. */
static dlgmd_blend between(int32_t first, int32_t second, dlgmd_place part)
{
    return (float)first + part * (float)(second - first);
}

/* A cell less what is between two others, in grey levels. */
static rest rest_of(int32_t cell, dlgmd_blend left, dlgmd_blend right, dlgmd_place part)
{
    return (float)cell - left - part * (right - left);
}

static rest slope_in_levels(int32_t sobel)
{
    return 0.125f * (float)sobel;
}

/* 1 / (1 + (apart / scale)^2) */
static float weight_of(rest apart, rest scale)
{
    return scale * scale / (scale * scale + apart * apart);
}

/* One and a half times the mean difference, and a grey level. */
static rest scale_of(moment sum, int n)
{
    return 1.5f * sum / (float)n + 1.0f;
}

/* Solve for the motion, which is added. The places in the sums are in halves of a cell. */
static void solve(moment m[4][5], dlgmd_motion *found)
{
    float q[4];
    for (int i = 0; i < 4; i++) {
        m[i][i] += 1e-6f * m[i][i] + (i < 2 ? 1e-3f : 0.4f);
    }
    for (int k = 0; k < 4; k++) {
        for (int i = k + 1; i < 4; i++) {
            float factor = m[i][k] / m[k][k];
            for (int j = k; j < 5; j++) {
                m[i][j] -= factor * m[k][j];
            }
        }
    }
    for (int k = 3; k >= 0; k--) {
        float sum = m[k][4];
        for (int j = k + 1; j < 4; j++) {
            sum -= m[k][j] * q[j];
        }
        q[k] = sum / m[k][k];
        found[k] += k < 2 ? q[k] : 2.0f * q[k];
    }
}

#endif

/* Whether a place is between cells of a side of `n`. */
static bool is_within(dlgmd_place at, int n)
{
    return at >= 0 && cell_of(at) < n - 1;
}

/* Where the cells of a window have moved to, in a row of the picture that are all or partly in it. */
static dlgmd_place row_of(window part, int y, const dlgmd_motion *by)
{
    int mid = part.top + part.bottom - 1;
    return place_of(mid, 2 * y - mid, by[0], by[2]);
}

/* Keep the differences between a row of the window and where it has moved to, `line`; returns their
   sum. */
static rest see_row_of(dlgmd_state *state, window part, int y, int *n_seen)
{
    const uint8_t *here = state->work.fit.before[y - part.top + 1] + 1;
    const int16_t *cells = state->work.fit.cells;
    dlgmd_rest *rests = state->work.fit.rests[y - part.top];
    rest sum = 0;
    int n = 0;
    for (int x = 0; x < part.right - part.left; x++) {
        if (cells[x] >= 0) {
            const dlgmd_blend *line = state->work.fit.line + cells[x];
            rest apart = rest_of(here[x], line[0], line[1], state->work.fit.parts[x]);
            rests[x] = (dlgmd_rest)apart;
            sum += apart < 0 ? -apart : apart;
            n++;
        }
    }
    *n_seen += n;
    return sum;
}

/* Keep the differences between a window of the earlier picture and where it has moved to, and find
   their scale; false if too little of it is seen. */
static bool see_rests(dlgmd_state *state, const uint8_t *frame, window part, const dlgmd_motion *by,
                      rest *scale)
{
    int from = SMALL_X, to = 0, mid = part.left + part.right - 1;
    for (int x = part.left; x < part.right; x++) {
        dlgmd_place at = place_of(mid, 2 * x - mid, by[1], by[3]);
        int cell = is_within(at, SMALL_X) ? cell_of(at) : -1;
        state->work.fit.cells[x - part.left] = (int16_t)cell;
        if (cell >= 0) {
            state->work.fit.parts[x - part.left] = beyond(at);
            from = cell < from ? cell : from;
            to = cell + 2 > to ? cell + 2 : to;
        }
    }
    moment sum = 0;
    int n_seen = 0, held[2] = {-1, -1}; /* rows of the newest picture */
    for (int y = part.top; from < to && y < part.bottom; y++) {
        dlgmd_place at_y = row_of(part, y, by);
        if (!is_within(at_y, SMALL_Y)) {
            continue;
        }
        for (int row = cell_of(at_y); row <= cell_of(at_y) + 1; row++) {
            if (held[row % 2] != row) {
                reduce(frame, row, from, to, state->work.fit.now[row % 2] + from);
                held[row % 2] = row;
            }
        }
        const uint8_t *above = state->work.fit.now[cell_of(at_y) % 2];
        const uint8_t *below = state->work.fit.now[(cell_of(at_y) + 1) % 2];
        for (int x = from; x < to; x++) {
            state->work.fit.line[x] = between(above[x], below[x], beyond(at_y));
        }
        sum += see_row_of(state, part, y, &n_seen);
    }
    *scale = n_seen ? scale_of(sum, n_seen) : 0;
    return 4 * n_seen >= (part.bottom - part.top) * (part.right - part.left);
}

/* Add the products of the slopes of row `y` to the sums. */
static void add_row(const dlgmd_state *state, window part, int y, rest scale, moment m[4][5])
{
    const uint8_t *up = state->work.fit.before[y - part.top], *here = up + LINE, *down = here + LINE;
    const int16_t *cells = state->work.fit.cells;
    const dlgmd_rest *rests = state->work.fit.rests[y - part.top];
    moment yy = 0, yx = 0, xx = 0, yxx = 0, xxx = 0, xxxx = 0, ry = 0, rx = 0, rxx = 0;
    rest place_x = (rest)(part.left - part.right - 1);
    /* Of the columns before, here and after: their weighted sum, and how much they rise. */
    int32_t sum = 0, next_sum = 0, rise = 0, next_rise = 0;
    for (int x = -2; x < part.right - part.left; x++) {
        int32_t last_sum = sum, last_rise = rise;
        sum = next_sum;
        rise = next_rise;
        next_sum = up[x + 2] + 2 * here[x + 2] + down[x + 2];
        next_rise = down[x + 2] - up[x + 2];
        if (x < 0) {
            continue;
        }
        place_x += 2;
        if (cells[x] < 0) {
            continue;
        }
        rest g_x = slope_in_levels(next_sum - last_sum);
        rest g_y = slope_in_levels(last_rise + 2 * rise + next_rise), apart = rests[x];
        rest weight = weight_of(apart, scale), g_xx = g_x * place_x;
        rest w_x = weight * g_x, w_y = weight * g_y, w_xx = weight * g_xx;
        yy += (moment)w_y * g_y;
        yx += (moment)w_y * g_x;
        xx += (moment)w_x * g_x;
        yxx += (moment)w_xx * g_y;
        xxx += (moment)w_xx * g_x;
        xxxx += (moment)w_xx * g_xx;
        ry += (moment)w_y * apart;
        rx += (moment)w_x * apart;
        rxx += (moment)w_xx * apart;
    }
    moment from = (moment)(2 * y - part.top - part.bottom + 1);
    const moment row[4][5] = {{yy, yx, from * yy, yxx, ry},
                              {0, xx, from * yx, xxx, rx},
                              {0, 0, from * from * yy, from * yxx, from * ry},
                              {0, 0, 0, xxxx, rxx}};
    for (int i = 0; i < 4; i++) {
        for (int j = i; j < 5; j++) {
            m[i][j] += row[i][j];
        }
    }
}

/* The motion of a window of the earlier picture: shift along y and x, and expansion along both. */
static void fit(dlgmd_state *state, const uint8_t *frame, window part, dlgmd_motion *by)
{
    for (int y = part.top - 1; y <= part.bottom; y++) {
        uint8_t *row = state->work.fit.before[y - part.top + 1];
        reduce(state->previous, y, part.left - 1, part.right + 1, row);
    }
    for (int step = 0; step < 2; step++) {
        moment m[4][5] = {{0}};
        rest scale;
        if (!see_rests(state, frame, part, by, &scale)) {
            memset(by, 0, 4 * sizeof *by);
            return;
        }
        for (int y = part.top; y < part.bottom; y++) {
            if (is_within(row_of(part, y, by), SMALL_Y)) {
                add_row(state, part, y, scale, m);
            }
        }
        for (int i = 0; i < 4; i++) {
            for (int j = 0; j < i; j++) {
                m[i][j] = m[j][i];
            }
        }
        solve(m, by);
    }
}

static dlgmd_motion lesser(dlgmd_motion a, dlgmd_motion b)
{
    return a < b ? a : b;
}

static dlgmd_motion larger_of(dlgmd_motion a, dlgmd_motion b)
{
    return a > b ? a : b;
}

static dlgmd_motion magnitude(dlgmd_motion a)
{
    return a < 0 ? -a : a;
}


/* Where the change spreads along a side of `n` cells; false if it spreads too far. */
static bool spread_of(moment mass, moment first, moment second, int n, int *at, int *reach)
{
    moment mid = first * MOMENT / mass, square = second * MOMENT / mass - mid * mid / MOMENT;
    if (100 * square > 81 * SIDE * SIDE * (moment)MOMENT) {
        return false;
    }
    int cells = LEAST_REACH;
    while (2 * cells + 1 <= SIDE &&
           (moment)(100 * (2 * cells + 1) * (2 * cells + 1)) * MOMENT <= 1024 * square) {
        cells++;
    }
    int middle = (int)((2 * first + mass) / (2 * mass));
    *reach = cells;
    *at = middle < cells + 1 ? cells + 1 : middle > n - 2 - cells ? n - 2 - cells : middle;
    return true;
}

/* The expansion of what moves in front of a still background, about a point inside it; else 0. */
static dlgmd_motion approach(dlgmd_state *state, const uint8_t *frame)
{
    int64_t sum = 0;
    for (int y = 0; y < SMALL_Y; y++) {
        uint8_t *now = state->work.moving.now, *change = state->work.moving.change[y];
        uint32_t row = 0;
        reduce(frame, y, 0, SMALL_X, now);
        reduce(state->previous, y, 0, SMALL_X, change);
        for (int x = 0; x < SMALL_X; x++) {
            change[x] = distance(now[x], change[x]);
            row += change[x];
        }
        sum += row;
    }
    rest least = 3 * CHANGE + (rest)((moment)sum * CHANGE / (SMALL_Y * SMALL_X));
    int level = (int)(least / CHANGE); /* what changes by more is above */
    moment mass = 0;
    moment first[2] = {0, 0}, second[2] = {0, 0};
    int n_above = 0;
    for (int y = 0; y < SMALL_Y; y++) {
        const uint8_t *change = state->work.moving.change[y];
        rest row = 0;
        for (int x = 0; x < SMALL_X; x++) {
            if (change[x] > level) {
                rest above = (rest)change[x] * CHANGE - least;
                row += above;
                first[1] += (moment)above * (rest)x;
                second[1] += (moment)above * (rest)(x * x);
                n_above++;
            }
        }
        mass += (moment)row;
        first[0] += (moment)row * (rest)y;
        second[0] += (moment)row * (rest)(y * y);
    }
    int at_y, at_x, reach_y, reach_x;
    if (100 * mass < 19 * CHANGE * (SMALL_Y * SMALL_X) ||
        5 * n_above > 2 * SMALL_Y * SMALL_X ||
        !spread_of(mass, first[0], second[0], SMALL_Y, &at_y, &reach_y) ||
        !spread_of(mass, first[1], second[1], SMALL_X, &at_x, &reach_x)) {
        return 0;
    }
    dlgmd_motion by[4] = {0, 0, 0, 0};
    window part = {at_y - reach_y, at_y + reach_y + 1, at_x - reach_x, at_x + reach_x + 1};
    fit(state, frame, part, by);
    bool passes = magnitude(by[0]) >= by[2] * (dlgmd_motion)reach_y || magnitude(by[1]) >= by[3] * (dlgmd_motion)reach_x;
    return passes ? 0 : larger_of(lesser(by[2], by[3]), 0);
}

/* Measure how fast the picture expands that has moved by dy and dx cells. */
static void expand(dlgmd_state *state, const uint8_t *frame, int dy, int dx)
{
    int top = (SMALL_Y - SIDE) / 2, left = (SMALL_X - SIDE) / 2;
    window middle = {top, top + SIDE, left, left + SIDE};
    if (middle.bottom - middle.top < 10) {
        return;
    }
    dlgmd_motion by[4] = {(dlgmd_motion)dy * ONE / FACTOR, (dlgmd_motion)dx * ONE / FACTOR, 0, 0};
    fit(state, frame, middle, by);
    dlgmd_motion rate = lesser(by[2], by[3]) - magnitude(by[2] - by[3]) / 4;
    state->ahead += part_of(per_second(state, rate) - state->ahead, newest_of(state, AHEAD_RATE));
    rate = state->blocks_y == 0 && state->blocks_x == 0 ? approach(state, frame) : 0;
    state->beside += part_of(per_second(state, rate) - state->beside, newest_of(state, BESIDE_RATE));
}

/* The rate of expansion, per second. */
static dlgmd_motion expansion(const dlgmd_state *state)
{
    return larger_of(state->ahead, state->beside / 2);
}

#endif

/* By how much the picture has moved. */
static void follow(dlgmd_state *state, const uint8_t *frame, int *dy, int *dx)
{
    int most_y = limit_of(BLOCKS_Y), most_x = limit_of(BLOCKS_X), y = 0, x = 0;
    see_blocks(state->work.blocks[0], frame);
    see_blocks(state->work.blocks[1], state->previous);
    fraction here = change_of_blocks(state, 0, 0);
    fraction last = change_of_blocks(state, state->blocks_y, state->blocks_x);
    if (is_less(last, here)) {
        y = state->blocks_y;
        x = state->blocks_x;
        here = last;
    }
    for (bool is_better = true; is_better;) {
        int from_y = y, from_x = x;
        is_better = false;
        for (int i = from_y - 1; i <= from_y + 1; i++) {
            for (int j = from_x - 1; j <= from_x + 1; j++) {
                if (size_of(i) >= most_y || size_of(j) >= most_x) {
                    continue;
                }
                fraction change = change_of_blocks(state, i, j);
                if (is_less(change, here)) {
                    here = change;
                    y = i;
                    x = j;
                    is_better = true;
                }
            }
        }
    }
    state->blocks_y = y;
    state->blocks_x = x;
    *dy = cells_of(y, change_of_blocks(state, y - 1, x), here, change_of_blocks(state, y + 1, x));
    *dx = cells_of(x, change_of_blocks(state, y, x - 1), here, change_of_blocks(state, y, x + 1));
#if DLGMD_EXPANDS
    expand(state, frame, *dy, *dx);
#endif
}

/* Move a row by `dx`: `from` may be the row itself. */
static void move_row(uint8_t *row, const uint8_t *from, int dx)
{
    memmove(row + (dx > 0 ? dx : 0), from - (dx < 0 ? dx : 0), (size_t)(WIDTH - size_of(dx)));
}

/* Where the cells of a row enter that has moved by `dx`. */
static int entering(int dx)
{
    return dx > 0 ? 0 : WIDTH + dx;
}

/* Sum of the change where the picture, moved by dx and dy, overlaps with the frame. */
static uint32_t change_of(const uint8_t *before, const uint8_t *frame, int dx, int dy)
{
    uint32_t sum = 0;
    for (int y = dy > 0 ? dy : 0; y < HEIGHT + (dy < 0 ? dy : 0); y++) {
        const uint8_t *now = frame + y * WIDTH, *then = before + (y - dy) * WIDTH - dx;
        for (int x = dx > 0 ? dx : 0; x < WIDTH + (dx < 0 ? dx : 0); x++) {
            sum += distance(now[x], then[x]);
        }
    }
    return sum;
}

/* Move the frame before, and the change of earlier frames, along with the picture. */
static void align(dlgmd_state *state, const uint8_t *frame)
{
    int dy, dx;
    follow(state, frame, &dy, &dx);
    if (dy == 0 && dx == 0) {
        return;
    }
    uint64_t moved = change_of(state->previous, frame, dx, dy);
    uint64_t cells = (uint64_t)(WIDTH - size_of(dx)) * (uint64_t)(HEIGHT - size_of(dy));
    uint64_t still = change_of(state->previous, frame, 0, 0);
    if (moved * CELLS * 20 >= still * cells * 19) {
        return; /* less than a twentieth of the change would be gone */
    }
    for (int i = 0; i < HEIGHT; i++) {
        int y = dy > 0 ? HEIGHT - 1 - i : i; /* no row is overwritten before it is read */
        bool is_known = y - dy >= 0 && y - dy < HEIGHT;
        uint8_t *row = state->previous + y * WIDTH;
        if (is_known) {
            move_row(row, row - dy * WIDTH, dx);
            memcpy(row + entering(dx), frame + y * WIDTH + entering(dx), (size_t)size_of(dx));
        } else {
            memcpy(row, frame + y * WIDTH, WIDTH);
        }
        for (int delay = 1; delay < DELAYS; delay++) {
            int first = (int)state->start + ROWS + RADIUS - delay * DLGMD_PERIOD;
            row = ring_row(state, (first + y) % ROWS);
            if (is_known) {
                move_row(row, ring_row(state, (first + y - dy) % ROWS), dx);
                memset(row + entering(dx), 0, (size_t)size_of(dx));
            } else {
                memset(row, 0, WIDTH);
            }
            if ((first + y) % ROWS < 2 * RADIUS) {
                memcpy(ring_row(state, (first + y) % ROWS + ROWS), row, WIDTH);
            }
        }
    }
}

#endif

#if DLGMD_CONTRAST

/* sqrt(n) * 2^shift, where `shift` is the largest that fits. */
static uint32_t root(uint64_t n, unsigned *shift)
{
    uint64_t found = 0;
    *shift = 0;
    if (n == 0) {
        return 0;
    }
    for (; n >> 62 == 0; n <<= 2) {
        ++*shift;
    }
    for (uint64_t bit = UINT64_C(1) << 62; bit != 0; bit >>= 2) {
        bool fits = n >= found + bit;
        n -= fits ? found + bit : 0;
        found = (found >> 1) + (fits ? bit : 0);
    }
    return (uint32_t)found;
}

#if DLGMD_FIXED

/* found / 2^shift / CELLS, in 1/65536 */
static number mean_of(uint32_t found, unsigned shift)
{
    return (number)((((uint64_t)found << 16) / CELLS) >> shift);
}

static number of_level(uint32_t level)
{
    return level << 16;
}

static number times(number value, number factor)
{
    return (number)((uint64_t)value * factor >> 16);
}

/* Running average; the weight of the newest value is in 1/32768. */
static total smoothed(total before, total newest, int32_t weight)
{
    return before + (total)((int64_t)(newest - before) * weight >> 15);
}

/* P': the change above `least`, in 1/128. */
static dlgmd_change passing(uint32_t level, number least)
{
    return (dlgmd_change)(of_level(level) > least ? (of_level(level) - least) >> 9 : 0);
}

/* A change as one per usual frame. */
static total per_usual(const dlgmd_state *state, total change)
{
    return (change << 16) / state->n_usual;
}

/* Square of the share of G that is not inhibited, in 1/32768. */
static number uninhibited(total usual, total sum)
{
    total limit = usual * GROWTH >> 14;
    number share = sum <= limit ? 32768 : (number)((limit << 15) / sum);
    return share * share >> 15;
}

static dlgmd_sum threshold_of(number least)
{
    uint64_t threshold = (uint64_t)least << S_BITS >> 16;
    return threshold < INT32_MAX ? (dlgmd_sum)threshold : INT32_MAX;
}

static total scaled(total value, number share)
{
    return value * share >> 15;
}

#if DLGMD_BALANCE
static total both_of(total value)
{
    return value * BOTH >> 15;
}
#endif

#if DLGMD_ADAPTS
static total above_mean(total mean)
{
    return mean * C_M >> 16;
}
#endif

#if DLGMD_EXPANDS
/* K, the more the faster the picture expands. The ratio to D_0 is in 1/1024, from 1 to 16. */
static total expanding(total mp, dlgmd_motion rate)
{
    int64_t ratio = rate > 0 ? rate * EXPANSION >> 24 : 0;
    ratio = ratio < 1024 ? 1024 : ratio < 16384 ? ratio : 16384;
    mp = mp >> 35 == 0 ? mp : UINT64_C(1) << 35; /* or the product is more than 64 bits */
    return ((total)(ratio * ratio) * (mp + K_0) >> 20) - K_0;
}

/* In 1/4096 s. */
static uint16_t time_left(dlgmd_motion rate)
{
    return (uint16_t)(rate >= LEAST_RATE ? TIME_LEFT / rate : 0);
}
#endif

#else

/* found / 2^shift / CELLS */
static number mean_of(uint32_t found, unsigned shift)
{
    number mean = (number)found / CELLS;
    for (; shift > 0; shift--) {
        mean *= 0.5f;
    }
    return mean;
}

static number of_level(uint32_t level)
{
    return (number)level;
}

static number times(number value, number factor)
{
    return value * factor;
}

/* Running average. */
static total smoothed(total before, total newest, float weight)
{
    return before + weight * (newest - before);
}

/* P': the change above `least`. */
static dlgmd_change passing(uint32_t level, number least)
{
    return of_level(level) > least ? of_level(level) - least : 0.0f;
}

/* A change as one per usual frame. */
static total per_usual(const dlgmd_state *state, total change)
{
    return change / state->n_usual;
}

/* Square of the share of G that is not inhibited. */
static number uninhibited(total usual, total sum)
{
    number limit = GROWTH * usual, share = sum <= limit ? 1.0f : limit / sum;
    return share * share;
}

static dlgmd_sum threshold_of(number least)
{
    return least;
}

static total scaled(total value, number share)
{
    return value * share;
}

#if DLGMD_BALANCE
static total both_of(total value)
{
    return value * BOTH;
}
#endif

#if DLGMD_ADAPTS
static total above_mean(total mean)
{
    return mean * C_M;
}
#endif

#if DLGMD_EXPANDS
/* K, the more the faster the picture expands. */
static total expanding(total mp, dlgmd_motion rate)
{
    float ratio = rate * EXPANSION;
    ratio = ratio < 1.0f ? 1.0f : ratio < 16.0f ? ratio : 16.0f;
    return ratio * ratio * (mp + K_0) - K_0;
}

/* In seconds. */
static float time_left(dlgmd_motion rate)
{
    return rate >= LEAST_RATE ? TIME_LEFT / rate : 0.0f;
}
#endif

#endif

static number larger(number a, number b)
{
    return a > b ? a : b;
}

/* Standard deviation of the frame, in grey levels. */
static number deviation(const uint8_t *frame)
{
    int32_t sum = 0;
    uint32_t squares = 0;
    for (int i = 0; i < CELLS; i++) {
        int32_t level = frame[i] - 128;
        sum += level;
        squares += (uint32_t)(level * level);
    }
    unsigned shift;
    uint32_t found = root((uint64_t)squares * CELLS - (uint64_t)((int64_t)sum * sum), &shift);
    return mean_of(found, shift);
}

/* Histograms of the change. */
static void count_changes(dlgmd_state *state, const uint8_t *frame)
{
    const uint8_t *before = state->previous;
    memset(&state->work.counts, 0, sizeof state->work.counts);
    for (int i = 0; i < CELLS; i++) {
        state->work.counts.all[distance(frame[i], before[i])]++;
    }
    for (int y = 0; QUARTILE_STEP > 1 && y < HEIGHT; y += QUARTILE_STEP) {
        for (int i = y * WIDTH; i < (y + 1) * WIDTH; i += QUARTILE_STEP) {
            state->work.counts.some[distance(frame[i], before[i])]++;
        }
    }
}

/* Lower quartile of the change, in grey levels. */
static uint32_t lower_quartile(const uint32_t *counts)
{
    uint32_t level = 0;
    for (uint32_t seen = counts[0]; seen <= QUARTILE_CELLS / 4; seen += counts[level]) {
        level++;
    }
    return level;
}

/* Compute P' by change, the threshold of S, and return the factor for G. */
static number see_contrast(dlgmd_state *state, const uint8_t *frame, dlgmd_sum *above)
{
    number newest = deviation(frame);
    if (state->frame == 0) {
        state->sigma = newest;
        return 0;
    }
    state->sigma = (number)smoothed(state->sigma, newest, newest_of_frames(state, SIGMA_RATE));
    count_changes(state, frame);
    bool has_all = QUARTILE_STEP == 1;
    newest = of_level(lower_quartile(has_all ? state->work.counts.all : state->work.counts.some));
    state->noise = state->frame == 1
                       ? newest
                       : (number)smoothed(state->noise, newest, newest_of_frames(state, SIGMA_RATE));
    number least = larger(times(state->sigma, C_P), times(state->noise, C_N));
    least = larger(least, P_MIN);
    dlgmd_change *passed = state->passed[state->frame % DELAYS];
    total sum = 0;
    for (uint32_t level = 0; level < 256; level++) {
        passed[level] = passing(level, least);
        sum += (total)state->work.counts.all[level] * passed[level];
    }
    sum = per_usual(state, sum);
    number share = (number)per_usual(state, uninhibited(state->usual, sum));
    state->usual =
        state->frame == 1 ? sum : smoothed(state->usual, sum, newest_of_frames(state, USUAL_RATE));
    *above = threshold_of(larger(times(state->sigma, C_S), S_MIN));
    return share;
}

/* Count the active cells of row `y`. */
static void read_row(const dlgmd_sum *s, int y, dlgmd_sum above, totals *sums)
{
    number active = 0, column = 0;
#if DLGMD_BALANCE
    number left = 0;
#endif
    for (int x = 0; x < WIDTH; x++) {
        if (s[x] > above) {
            active += weights_x[x];
            column += weights_x[x] * (number)x;
        }
#if DLGMD_BALANCE
        if (x == (WIDTH - 1) / 2) {
            left = active;
        }
#endif
    }
    total row = (total)active * weights_y[y];
    sums->g += row;
    sums->g_column += (total)column * weights_y[y];
    sums->g_row += row * (total)y;
#if DLGMD_BALANCE
    /* A middle row or column belongs to both sides. */
    number right = active - left;
    if (WIDTH % 2 == 1 && s[WIDTH / 2] > above) {
        right += weights_x[WIDTH / 2];
    }
    for (int below = y < (HEIGHT + 1) / 2 ? 0 : 1; below <= (y < HEIGHT / 2 ? 0 : 1); below++) {
        sums->quadrants[2 * below] += (total)left * weights_y[y];
        sums->quadrants[2 * below + 1] += (total)right * weights_y[y];
    }
#endif
}

#if DLGMD_BALANCE

/* K by the two quadrants with the least G. */
static total weakest(const total *quadrants)
{
    total least = quadrants[0], second = quadrants[1];
    for (int i = 1; i < 4; i++) {
        total one = quadrants[i];
        if (i == 1 ? one <= least : one < least) {
            second = least;
            least = one;
        } else if (i == 1 || one < second) {
            second = one;
        }
    }
    return both_of(least + second);
}

#endif

#if DLGMD_ADAPTS

/* What of K exceeds its mean over the earlier frames. */
static total adapted(dlgmd_state *state, total mp)
{
    total before = state->frame == FIRST_VALID ? mp : state->mean;
    state->mean = smoothed(before, mp, newest_of(state, MEAN_RATE));
    before = above_mean(before);
    return mp > before ? mp - before : 0;
}

#endif

/* Process a frame and sum G; false while the history is not full. */
static bool respond(dlgmd_state *state, const uint8_t *frame, totals *sums)
{
    dlgmd_sum above = 0;
#if DLGMD_SHIFT > 0
    if (state->frame > 0) {
        align(state, frame);
    }
#endif
    number share = see_contrast(state, frame, &above);
    bool valid = state->frame >= FIRST_VALID;
    memset(&state->work.rows, 0, sizeof state->work.rows);
    for (int y = -RADIUS; y < HEIGHT; y++) {
        see_row(state, frame, y + RADIUS);
        if (valid && y >= 0) {
            sum_row(state, y, state->work.rows.s);
            read_row(state->work.rows.s, y, above, sums);
        }
    }
#if DLGMD_BALANCE
    sums->mp = scaled(weakest(sums->quadrants), share);
#else
    sums->mp = scaled(sums->g, share);
#endif
#if DLGMD_ADAPTS
    if (valid) {
        sums->mp = adapted(state, sums->mp);
    }
#endif
#if DLGMD_EXPANDS
    sums->mp = expanding(sums->mp, expansion(state));
#endif
    sums->g = scaled(sums->g, share);
    sums->g_column = scaled(sums->g_column, share);
    sums->g_row = scaled(sums->g_row, share);
    return valid;
}

#else

#if DLGMD_FIXED

/* Threshold of G. It and the next functions are in units of 1 / G_ONE. */
static number threshold_of(uint32_t ffi)
{
    uint64_t threshold = (uint64_t)ffi * T_DE >> T_DE_SHIFT;
    return threshold < T_DE_MAX ? (number)threshold : T_DE_MAX;
}

/* G, at most 1. */
static number product(number s, number ce)
{
    number g = ce < 65536 ? s * ce : s * (ce >> 4);
    if (ce >= 65536) {
        g = g < G_ONE >> 4 ? g << 4 : G_ONE;
    }
    return g < G_ONE ? g : G_ONE;
}

/* In 1/4096. */
static number rounded(number g)
{
    return (g + (G_ONE >> 13)) / (G_ONE >> 12);
}

#else

static number threshold_of(uint32_t ffi)
{
    number threshold = T_DE * (number)ffi;
    return threshold < T_DE_MAX ? threshold : T_DE_MAX;
}

static number product(number s, number ce)
{
    number g = GAIN * s * ce;
    return g < G_MAX ? g : G_MAX;
}

static number rounded(number g)
{
    return g;
}

#endif

/* G of row `y` - 2, from the last four rows of S. Ce is the sum of 4 x 4 cells of S. */
static void read_row(dlgmd_sum (*s)[WIDTH + 3], int y, number t_de, totals *sums)
{
    const dlgmd_sum *above = s[(y + 1) & 3], *here = s[(y + 2) & 3];
    const dlgmd_sum *below = s[(y + 3) & 3], *last = s[y & 3];
    number a, b = 0, c = 0, d = 0, row = 0, column = 0;
    for (int x = 0; x < WIDTH + 3; x++) {
        a = b;
        b = c;
        c = d;
        d = (number)above[x] + here[x] + below[x] + last[x];
        if (x >= 3 && here[x - 2] > 0) {
            number g = product(here[x - 2], a + b + c + d);
            if (g >= t_de) {
                g = rounded(g);
                row += g;
                column += g * (number)(x - 3);
            }
        }
    }
    sums->g += row;
    sums->g_column += column;
    sums->g_row += (total)row * (total)(y - 2);
}

/* Process a frame and sum G; false while the history is not full. */
static bool respond(dlgmd_state *state, const uint8_t *frame, totals *sums)
{
    bool valid = state->frame >= FIRST_VALID;
    uint32_t *ffi = state->change_sums;
    memmove(ffi + 1, ffi, DLGMD_FFI_DELAY * sizeof *ffi);
    number t_de = threshold_of(ffi[DLGMD_FFI_DELAY]);
    ffi[0] = 0;
    memset(&state->work.rows, 0, sizeof state->work.rows);
    dlgmd_sum(*s)[WIDTH + 3] = state->work.rows.s;
    for (int y = -RADIUS; y < HEIGHT; y++) {
        ffi[0] += see_row(state, frame, y + RADIUS);
        if (valid && y >= 0) {
            sum_row(state, y, s[y & 3] + 1);
            if (y >= 2) {
                read_row(s, y, t_de, sums);
            }
        }
    }
    for (int y = HEIGHT; valid && y < HEIGHT + 2; y++) {
        memset(s[y & 3], 0, sizeof s[0]);
        read_row(s, y, t_de, sums);
    }
    sums->mp = sums->g;
    return valid;
}

#endif

#if DLGMD_FIXED

/* The centroid of G along a side, (2 place + 1) / side - 1, in 1/32768. */
static int16_t centroid(total g_place, total g, int32_t side)
{
    for (; g_place >> 47 != 0; g_place >>= 1) {
        g >>= 1;
    }
    if (g == 0) {
        return 0;
    }
    return (int16_t)(((int64_t)((g_place << 16) / g) + 32768) / side - 32768);
}

static void finish(dlgmd_answer *answer, const totals *sums)
{
#if DLGMD_CONTRAST
    total mp = sums->mp * CELLS >> 20;
    answer->mp = mp < UINT32_MAX ? (uint32_t)mp : UINT32_MAX;
#else
    answer->mp = (uint32_t)sums->mp;
#endif
    answer->mp_abs = (uint16_t)((sums->mp << 15) / (sums->mp + KAPPA));
    answer->g_x = centroid(sums->g_column, sums->g, WIDTH);
    answer->g_y = centroid(sums->g_row, sums->g, HEIGHT);
}

#else

static void finish(dlgmd_answer *answer, const totals *sums)
{
    answer->mp = sums->mp;
    answer->mp_abs = sums->mp / (sums->mp + KAPPA);
    if (sums->g > 0.0f) {
        answer->g_x = (2.0f * sums->g_column / sums->g + 1.0f) / WIDTH - 1.0f;
        answer->g_y = (2.0f * sums->g_row / sums->g + 1.0f) / HEIGHT - 1.0f;
    }
}

#endif

dlgmd_answer dlgmd_step(dlgmd_state *state, const uint8_t *frame, uint32_t step_ms)
{
    dlgmd_answer answer = {0};
    totals sums = {0};
#if DLGMD_CONTRAST
    see_time(state, step_ms);
#else
    (void)step_ms;
#endif
    if (state->frame == 0) {
        memcpy(state->previous, frame, CELLS);
    }
    answer.valid = respond(state, frame, &sums);
    state->frame++;
    state->start = (state->start + DLGMD_PERIOD) % ROWS;
    if (answer.valid) {
        finish(&answer, &sums);
#if DLGMD_EXPANDS
        answer.ttc_s = time_left(expansion(state));
#endif
        answer.spike = answer.mp_abs >= T_MP;
        state->spikes = answer.spike ? state->spikes + 1 : 0;
        answer.alarm = state->spikes >= N_SP;
    }
    return answer;
}

/* The model, the expansion and the alarm; see dlgmd.h. Constants and sums are in dlgmd_model.h. */
#include "dlgmd.h"

#include <string.h>

enum {
    WIDTH = DLGMD_WIDTH,
    HEIGHT = DLGMD_HEIGHT,
    CELLS = DLGMD_WIDTH * DLGMD_HEIGHT,
    EARLIER = DLGMD_EARLIER,
    RADIUS = DLGMD_RADIUS,
    ROWS = DLGMD_ROWS,
    DELAYS = DLGMD_MAX_DELAY + 1
};

#include "dlgmd_model.h"

/* Sums over the rows so far: G, which is K in the end, and G times its column and its row. */
typedef struct {
    float g;
    float g_column;
    float g_row;
} totals;

#if DLGMD_EXPANSION
/* The window around the usual heading. */
static const dlgmd_window usual_window = WINDOW;
#endif

void dlgmd_reset(dlgmd_state *state)
{
    memset(state, 0, sizeof *state);
#if DLGMD_EXPANSION
    state->window = usual_window;
#endif
}

static uint8_t distance(uint8_t a, uint8_t b)
{
    return (uint8_t)(a < b ? b - a : a - b);
}

/* The frame so many before this one; that EARLIER before is the oldest, whose place this one takes. */
static uint8_t *frame_before(dlgmd_state *state, uint32_t n_ago)
{
    return state->frames[(state->frame + EARLIER - n_ago) % EARLIER];
}

/* Row `at` of the ring. */
static uint8_t *ring_row(dlgmd_state *state, int at)
{
    return state->change + DLGMD_MARGIN + at * DLGMD_STRIDE;
}

/* Store row `y` and its change, zeros below the frame, and return the sum of the latter. */
static uint32_t see_row(dlgmd_state *state, const uint8_t *frame, int y)
{
    int at = ((int)state->start + RADIUS + y) % ROWS;
    uint8_t *row = ring_row(state, at);
    uint32_t sum = 0;
    if (y < HEIGHT) {
        const uint8_t *now = frame + y * WIDTH;
        const uint8_t *before = frame_before(state, 1) + y * WIDTH;
        uint8_t *kept = frame_before(state, EARLIER) + y * WIDTH;
        for (int x = 0; x < WIDTH; x++) {
            row[x] = distance(now[x], before[x]);
            kept[x] = now[x];
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
static void sum_row(dlgmd_state *state, int y, float *s)
{
    const uint8_t *sources[DELAYS]; /* of each frame, the first row that the kernels reach */
    for (int delay = 0; delay < DELAYS; delay++) {
        int at = (int)state->start + ROWS + y - delay * DLGMD_PERIOD;
        sources[delay] = ring_row(state, at % ROWS);
    }
    sum_columns(sources, state->work.rows.columns);
    sum_along(sources, state->work.rows.columns, s);
}

static float threshold_of(uint32_t ffi)
{
    float threshold = T_DE * (float)ffi;
    return threshold < T_DE_MAX ? threshold : T_DE_MAX;
}

static float product(float s, float ce)
{
    float g = GAIN * s * ce;
    return g < G_MAX ? g : G_MAX;
}

/* G of row `y` - 2, from the last four rows of S. Ce is the sum of 4 x 4 cells of S. */
static void read_row(float (*s)[WIDTH + 3], int y, float t_de, totals *sums)
{
    const float *above = s[(y + 1) & 3], *here = s[(y + 2) & 3];
    const float *below = s[(y + 3) & 3], *last = s[y & 3];
    float a, b = 0, c = 0, d = 0, row = 0, column = 0;
    for (int x = 0; x < WIDTH + 3; x++) {
        a = b;
        b = c;
        c = d;
        d = (float)above[x] + here[x] + below[x] + last[x];
        if (x >= 3 && here[x - 2] > 0) {
            float g = product(here[x - 2], a + b + c + d);
            if (g >= t_de) {
                row += g;
                column += g * (float)(x - 3);
            }
        }
    }
    sums->g += row;
    sums->g_column += column;
    sums->g_row += row * (float)(y - 2);
}

/* Process a frame and sum G; false while the history is not full. */
static bool respond(dlgmd_state *state, const uint8_t *frame, totals *sums)
{
    bool valid = state->frame >= FIRST_VALID;
    uint32_t *ffi = state->change_sums;
    memmove(ffi + 1, ffi, DLGMD_FFI_DELAY * sizeof *ffi);
    float t_de = threshold_of(ffi[DLGMD_FFI_DELAY]);
    ffi[0] = 0;
    memset(&state->work.rows, 0, sizeof state->work.rows);
    float(*s)[WIDTH + 3] = state->work.rows.s;
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
    return valid;
}

static void finish(dlgmd_answer *answer, const totals *sums)
{
    answer->mp = sums->g;
    answer->mp_abs = sums->g / (sums->g + KAPPA);
    if (sums->g > 0.0f) {
        answer->g_x = (2.0f * sums->g_column / sums->g + 1.0f) / WIDTH - 1.0f;
        answer->g_y = (2.0f * sums->g_row / sums->g + 1.0f) / HEIGHT - 1.0f;
    }
}

#if DLGMD_EXPANSION

#if DLGMD_WIDTH > 240 || !DLGMD_SEES
#error "The expansion cannot be measured in images of this size, by a camera with these angles."
#endif

enum {
    N_LEVELS = DLGMD_TOP_LEVEL + 1,
    PATCH = DLGMD_PATCH,
    AROUND = DLGMD_PATCH + 3, /* cells in a row of a patch, with those that its slopes need */
    KEPT = DLGMD_KEPT,
    /* As OpenCV has them: most steps of a point per level, binary places of weights, and those
       that levels lose. */
    MOST_STEPS = 30,
    WEIGHT_BITS = 14,
    CELL_BITS = WEIGHT_BITS - 5
};

/* A point rests once it moves by less, in px. Sums of slopes are in units of this, as in OpenCV. */
#define LEAST_STEP 0.01f
#define SLOPE_UNIT (1.0f / (1 << 20))

/* An image to read: of a pyramid, the first is the frame. */
typedef struct {
    const uint8_t *cells;
    int width, height;
    const float *gains; /* of the rows, where the light flickers; else NULL */
} image;

/* The cell before a place, and the weights of the four cells around it. */
typedef struct {
    int x, y;
    int32_t weights[4];
} corner;

/* The change of a window between two images. */
typedef struct {
    float rate, upright; /* its growth, and that of what stands upright */
    float variance;     /* the square of the error of the growth */
} growth;

static float square(float a)
{
    return a * a;
}

static float root_of(float a)
{
    float root = 1.0f;
    for (int i = 0; i < 40 && a > 0.0f; i++) {
        root = (root + a / root) / 2.0f;
    }
    return a > 0.0f ? root : 0.0f;
}

static int floor_of(float a)
{
    int whole = (int)a;
    return whole - ((float)whole > a);
}

static float limited(float a, float least, float most)
{
    return a < least ? least : a > most ? most : a;
}

/* The share of the newest value in a mean that forgets at a rate per second: 1 - exp(-x). */
static float share_of_newest(float interval, float rate)
{
    float x = interval * rate;
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

#if DLGMD_EVENS

/* The period of the light in frames, by the change of the rows after so many; 0 if it is steady. */
static uint32_t period_of(dlgmd_state *state)
{
    const uint16_t *newest = state->row_sums[state->frame % KEPT];
    float *usual = state->row_changes;
    uint32_t period = 2;
    if (state->frame < KEPT - 1) {
        return 0;
    }
    state->n_changes += state->n_changes < 10;
    for (uint32_t k = 1; k < KEPT; k++) {
        const uint16_t *then = state->row_sums[(state->frame + KEPT - k) % KEPT];
        uint32_t change = 0;
        for (int y = 0; y < HEIGHT; y++) {
            change += (uint32_t)(newest[y] < then[y] ? then[y] - newest[y] : newest[y] - then[y]);
        }
        usual[k] += ((float)change / CELLS - usual[k]) / (float)state->n_changes;
        period = k > 1 && usual[k] < usual[period] ? k : period;
    }
    bool is_clear = usual[period] < 0.6f * usual[1];
    return is_clear && state->n_changes >= KEPT - 1 && usual[1] > 0.3f ? period : 0;
}

/* Find the gain of each row: its mean over a period, relative to its mean now. */
static void see_light(dlgmd_state *state, const uint8_t *frame)
{
    uint16_t *sums = state->row_sums[state->frame % KEPT];
    for (int y = 0; y < HEIGHT; y++) {
        uint32_t sum = 0;
        for (int x = 0; x < WIDTH; x++) {
            sum += frame[y * WIDTH + x];
        }
        sums[y] = (uint16_t)sum;
    }
    uint32_t period = period_of(state);
    float *gains = state->gains[state->frame % (EARLIER + 1)];
    gains[0] = 0.0f;
    for (int y = 0; period > 0 && y < HEIGHT; y++) {
        uint32_t sum = 0;
        for (uint32_t k = 0; k < period; k++) {
            sum += state->row_sums[(state->frame + KEPT - k) % KEPT][y];
        }
        float usual = (float)sum / (float)period;
        gains[y] = limited((usual + WIDTH) / (float)(sums[y] + WIDTH), 0.7f, 1.3f);
    }
}

#endif

/* The frame so many before this one, which is number 0. */
static image image_of(dlgmd_state *state, const uint8_t *frame, uint32_t n_ago)
{
    image of = {n_ago > 0 ? frame_before(state, n_ago) : frame, WIDTH, HEIGHT, NULL};
#if DLGMD_EVENS
    const float *gains = state->gains[(state->frame + EARLIER + 1 - n_ago) % (EARLIER + 1)];
    of.gains = gains[0] > 0.0f ? gains : NULL;
#endif
    return of;
}

/* Where a mirror at the edge of a side of `n` cells shows a place; edges are not repeated. */
static int mirrored(int at, int n)
{
    while (at < 0 || at >= n) {
        at = at < 0 ? -at : 2 * n - 2 - at;
    }
    return at;
}

/* Read `n` cells of a row, without flicker; the image is mirrored at its edges. */
static void read_cells(const image *from, int y, int x, int n, uint8_t *into)
{
    y = mirrored(y, from->height);
    const uint8_t *row = from->cells + y * from->width;
    if (x >= 0 && x + n <= from->width) {
        memcpy(into, row + x, (size_t)n);
    } else {
        for (int i = 0; i < n; i++) {
            into[i] = row[mirrored(x + i, from->width)];
        }
    }
    for (int i = 0; from->gains != NULL && i < n; i++) {
        float level = (float)into[i] * from->gains[y] + 0.5f;
        into[i] = (uint8_t)(level < 255.0f ? level : 255.0f);
    }
}

/* The image of half the size, as OpenCV's pyrDown has it. */
static image halved(dlgmd_track *track, const image *from, uint8_t *cells)
{
    static const uint8_t weights[5] = {1, 4, 6, 4, 1};
    uint16_t *sums = track->sums;
    uint8_t *row = track->row;
    image half = {cells, (from->width + 1) / 2, (from->height + 1) / 2, NULL};
    for (int y = 0; y < half.height; y++) {
        memset(sums, 0, sizeof track->sums);
        for (int i = 0; i < 5; i++) {
            read_cells(from, 2 * y + i - 2, -2, from->width + 4, row);
            for (int x = 0; x < from->width + 4; x++) {
                sums[x] = (uint16_t)(sums[x] + weights[i] * row[x]);
            }
        }
        for (int x = 0; x < half.width; x++) {
            const uint16_t *sum = sums + 2 * x;
            uint32_t total = (uint32_t)sum[0] + sum[4] + 4u * sum[1] + 4u * sum[3] + 6u * sum[2];
            *cells++ = (uint8_t)((total + 128) >> 8);
        }
    }
    return half;
}

static void see_levels(dlgmd_track *track, image *levels, uint8_t *cells)
{
    for (int i = 1; i < N_LEVELS; i++) {
        levels[i] = halved(track, levels + i - 1, cells);
        cells += levels[i].width * levels[i].height;
    }
}

/* Where the patch around a place begins. */
static corner corner_of(dlgmd_place middle)
{
    const float one = 1 << WEIGHT_BITS;
    float x = middle.x - (PATCH - 1) / 2, y = middle.y - (PATCH - 1) / 2;
    corner at = {floor_of(x), floor_of(y), {0, 0, 0, 0}};
    float right = x - (float)at.x, down = y - (float)at.y;
    at.weights[0] = (int32_t)((1.0f - right) * (1.0f - down) * one + 0.5f);
    at.weights[1] = (int32_t)(right * (1.0f - down) * one + 0.5f);
    at.weights[2] = (int32_t)((1.0f - right) * down * one + 0.5f);
    at.weights[3] = (1 << WEIGHT_BITS) - at.weights[0] - at.weights[1] - at.weights[2];
    return at;
}

static bool is_near(corner at, const image *in)
{
    return at.x >= -PATCH && at.x < in->width && at.y >= -PATCH && at.y < in->height;
}

/* A row of a patch between two rows of cells, with `bits` binary places less. */
static void blend(const int32_t *weights, const int16_t *above, const int16_t *below, int bits,
                  int16_t *into)
{
    const int32_t a = weights[0], b = weights[1], c = weights[2], d = weights[3];
    int32_t up = above[0], low = below[0];
    for (int x = 0; x < PATCH; x++) {
        int32_t next_up = above[x + 1], next_low = below[x + 1];
        int32_t sum = a * up + b * next_up + c * low + d * next_low;
        into[x] = (int16_t)((sum + (1 << (bits - 1))) >> bits);
        up = next_up;
        low = next_low;
    }
}

/* Keep the slopes of an image around a place, by Scharr's kernels; 0 outside. */
static void see_slopes(dlgmd_track *track, const image *from, corner at)
{
    bool is_inside = at.x >= 0 && at.y >= 0 && at.x + PATCH < from->width && at.y + PATCH < from->height;
    for (int y = 0; y < AROUND; y++) {
        read_cells(from, at.y + y - 1, at.x - 1, AROUND, track->around[y]);
    }
    for (int y = 0; y <= PATCH; y++) {
        const uint8_t *up = track->around[y], *here = up + AROUND, *down = here + AROUND;
        int16_t *right = track->slopes_x[y], *low = track->slopes_y[y];
        int means[3] = {0, 0, 0}, rises[3] = {0, 0, 0}; /* of the last columns */
        for (int x = -2; x <= PATCH; x++) {
            int at_x = x + 2;
            means[0] = means[1];
            means[1] = means[2];
            means[2] = 3 * (up[at_x] + down[at_x]) + 10 * here[at_x];
            rises[0] = rises[1];
            rises[1] = rises[2];
            rises[2] = down[at_x] - up[at_x];
            if (x >= 0) {
                right[x] = (int16_t)(means[2] - means[0]);
                low[x] = (int16_t)(3 * (rises[0] + rises[2]) + 10 * rises[1]);
            }
        }
        for (int x = 0; x <= PATCH && !is_inside; x++) {
            if (at.y + y < 0 || at.y + y >= from->height || at.x + x < 0 ||
                at.x + x >= from->width) {
                right[x] = 0;
                low[x] = 0;
            }
        }
    }
}

/* Keep the cells of an image from a place on. */
static void see_cells(dlgmd_track *track, const image *from, corner at)
{
    for (int y = 0; y <= PATCH; y++) {
        uint8_t *row = track->around[0];
        read_cells(from, at.y + y, at.x, PATCH + 1, row);
        for (int x = 0; x <= PATCH; x++) {
            track->cells[y][x] = row[x];
        }
    }
}

/* Keep the levels and slopes of a patch; `sums` are the products of slopes: xx, xy, yy. */
static void see_patch(dlgmd_track *track, const image *from, corner at, float *sums)
{
    see_slopes(track, from, at);
    see_cells(track, from, at);
    memset(sums, 0, 3 * sizeof *sums);
    for (int y = 0; y < PATCH; y++) {
        int16_t *right = track->right[y], *down = track->down[y];
        int32_t xx = 0, xy = 0, yy = 0;
        blend(at.weights, track->cells[y], track->cells[y + 1], CELL_BITS, track->levels[y]);
        blend(at.weights, track->slopes_x[y], track->slopes_x[y + 1], WEIGHT_BITS, right);
        blend(at.weights, track->slopes_y[y], track->slopes_y[y + 1], WEIGHT_BITS, down);
        for (int x = 0; x < PATCH; x++) {
            xx += right[x] * right[x];
            xy += right[x] * down[x];
            yy += down[x] * down[x];
        }
        sums[0] += (float)xx * SLOPE_UNIT;
        sums[1] += (float)xy * SLOPE_UNIT;
        sums[2] += (float)yy * SLOPE_UNIT;
    }
}

/* The sums of the slopes times how much brighter the kept cells are than the kept patch. */
static dlgmd_place mismatch(const dlgmd_track *track, corner at)
{
    dlgmd_place sum = {0.0f, 0.0f};
    for (int y = 0; y < PATCH; y++) {
        const int16_t *right = track->right[y], *down = track->down[y];
        int32_t sum_x = 0, sum_y = 0;
        int16_t levels[PATCH];
        blend(at.weights, track->cells[y], track->cells[y + 1], CELL_BITS, levels);
        for (int x = 0; x < PATCH; x++) {
            int32_t apart = levels[x] - track->levels[y][x];
            sum_x += apart * right[x];
            sum_y += apart * down[x];
        }
        sum.x += (float)sum_x * SLOPE_UNIT;
        sum.y += (float)sum_y * SLOPE_UNIT;
    }
    return sum;
}

/* Follow a point from one level of a pyramid to that of another one, where `there` is a guess; false
   if it is lost. */
static bool follow_level(dlgmd_track *track, const image *from, const image *to, dlgmd_place start,
                         dlgmd_place *there)
{
    float sums[3];
    corner at = corner_of(start), seen = at;
    dlgmd_place last = {0.0f, 0.0f};
    if (!is_near(at, from)) {
        return false;
    }
    see_patch(track, from, at, sums);
    float xx = sums[0], xy = sums[1], yy = sums[2], area = xx * yy - xy * xy;
    /* Whether the lesser eigenvalue is large enough. */
    if ((xx - LEAST_TEXTURE) * (yy - LEAST_TEXTURE) < xy * xy || xx + yy < 2.0f * LEAST_TEXTURE ||
        area < FLT_EPSILON) {
        return false;
    }
    for (int i = 0; i < MOST_STEPS; i++) {
        at = corner_of(*there);
        if (!is_near(at, to)) {
            return false;
        }
        if (i == 0 || at.x != seen.x || at.y != seen.y) {
            see_cells(track, to, at);
            seen = at;
        }
        dlgmd_place sum = mismatch(track, at);
        dlgmd_place step = {(xy * sum.y - yy * sum.x) / area, (xy * sum.x - xx * sum.y) / area};
        there->x += step.x;
        there->y += step.y;
        if (square(step.x) + square(step.y) <= square(LEAST_STEP)) {
            break;
        }
        if (i > 0 && square(step.x + last.x) < square(LEAST_STEP) &&
            square(step.y + last.y) < square(LEAST_STEP)) { /* to and fro */
            there->x -= 0.5f * step.x;
            there->y -= 0.5f * step.y;
            break;
        }
        last = step;
    }
    return is_near(corner_of(*there), to);
}

/* Where a point of one image is in the other one, from a guess on; false if it is lost. */
static bool follow(dlgmd_track *track, const image *from, const image *to, int n_levels,
                   dlgmd_place start, dlgmd_place *there)
{
    bool is_found = false;
    for (int i = n_levels - 1; i >= 0; i--) {
        const float unit = 1.0f / (float)(1 << i), twice = i < n_levels - 1 ? 2.0f : unit;
        there->x *= twice;
        there->y *= twice;
        dlgmd_place here = {start.x * unit, start.y * unit};
        is_found = follow_level(track, from + i, to + i, here, there);
    }
    return is_found;
}

/* Keep the points of a window that are found in the other image, and how far they have moved. */
static int follow_all(dlgmd_track *track, image (*pair)[N_LEVELS], dlgmd_window window)
{
    const int n = N_AHEAD;
    int n_found = 0;
    for (int i = 0; i < n * n; i++) {
        float right = (float)(i % n) / (float)(n - 1), down = (float)(i / n) / (float)(n - 1);
        dlgmd_place start = {window.left + right * (window.right - window.left),
                             window.top + down * (window.bottom - window.top)};
        dlgmd_place there = start, back = start;
        if (start.x >= 1.5f && start.x < WIDTH - 2.5f && start.y >= 1.5f &&
            start.y < HEIGHT - 2.5f && follow(track, pair[0], pair[1], N_LEVELS, start, &there) &&
            follow(track, pair[1], pair[0], N_LEVELS_BACK, there, &back) &&
            square(back.x - start.x) + square(back.y - start.y) < square(MAX_RETURN_PX)) {
            track->places[n_found] = start;
            track->moves[n_found] = (dlgmd_place){there.x - start.x, there.y - start.y};
            track->weights[n_found++] = 1.0f;
        }
    }
    return n_found;
}

/* Weigh the points by how far they are from where the fit has them. */
static void weigh(dlgmd_track *track, int n)
{
    float *sorted = track->sorted;
    for (int i = 0, at; i < n; i++) {
        for (at = i; at > 0 && sorted[at - 1] > track->squares[i]; at--) {
            sorted[at] = sorted[at - 1];
        }
        sorted[at] = track->squares[i];
    }
    float median = (root_of(sorted[(n - 1) / 2]) + root_of(sorted[n / 2])) / 2.0f;
    float scale = RESIDUALS * median + LEAST_PX;
    for (int i = 0; i < n; i++) {
        track->weights[i] = 1.0f / (1.0f + track->squares[i] / square(scale));
    }
}

/* The weighted mean of n vectors. */
static dlgmd_place mean_of(const dlgmd_place *vectors, const float *weights, int n)
{
    float total = 0.0f;
    dlgmd_place sum = {0.0f, 0.0f};
    for (int i = 0; i < n; i++) {
        total += weights[i];
        sum.x += weights[i] * vectors[i].x;
        sum.y += weights[i] * vectors[i].y;
    }
    return (dlgmd_place){sum.x / total, sum.y / total};
}

/* Fit a shift, a growth and a turn to the moves of n points; as `similarity` in Python. */
static growth fit(dlgmd_track *track, int n)
{
    growth found = {0.0f, 0.0f, 0.0f};
    float moment = 0.0f, total = 0.0f, left = 0.0f;
    for (int step = 0; step < N_STEPS; step++) {
        dlgmd_place middle = mean_of(track->places, track->weights, n);
        dlgmd_place shift = mean_of(track->moves, track->weights, n);
        float grown = 0.0f, turned = 0.0f;
        moment = 0.0f;
        for (int i = 0; i < n; i++) {
            float x = track->places[i].x - middle.x, y = track->places[i].y - middle.y;
            float dx = track->moves[i].x - shift.x, dy = track->moves[i].y - shift.y;
            moment += track->weights[i] * (x * x + y * y);
            grown += track->weights[i] * (x * dx + y * dy);
            turned += track->weights[i] * (x * dy - y * dx);
        }
        moment = moment > 1e-9f ? moment : 1e-9f;
        found.rate = grown / moment;
        float turn = turned / moment;
        for (int i = 0; i < n; i++) {
            float x = track->places[i].x - middle.x, y = track->places[i].y - middle.y;
            float dx = track->moves[i].x - shift.x - found.rate * x + turn * y;
            float dy = track->moves[i].y - shift.y - found.rate * y - turn * x;
            track->squares[i] = dx * dx + dy * dy;
        }
        weigh(track, n);
    }
    for (int i = 0; i < n; i++) {
        total += track->weights[i];
        left += square(track->weights[i]) * track->squares[i];
    }
    found.variance = square(OVERLAP) * left / (2.0f * total * moment);
    return found;
}

/* The growth across of the row of points that begins at i, and whether it has one; i becomes the
   first point of the next row. */
static bool widen(const dlgmd_track *track, int n, int *i, float *across)
{
    const int first = *i;
    while (*i < n && track->places[*i].y <= track->places[first].y) {
        (*i)++;
    }
    dlgmd_place middle = mean_of(track->places + first, track->weights + first, *i - first);
    float spread = 0.0f, grown = 0.0f;
    for (int k = first; k < *i; k++) {
        float x = track->places[k].x - middle.x;
        spread += track->weights[k] * square(x);
        grown += track->weights[k] * x * track->moves[k].x;
    }
    *across = spread > LEAST_SPREAD ? grown / spread : 0.0f;
    return spread > LEAST_SPREAD;
}

/* The growth of what stands upright, from the weights of `fit`; as `upright` in Python. False if
   all points are in one row, or no row has two. */
static bool stand(const dlgmd_track *track, int n, float *upright)
{
    dlgmd_place middle = mean_of(track->places, track->weights, n);
    float moment = 0.0f, down = 0.0f, above = 0.0f, total = 0.0f, sum = 0.0f, across = 0.0f;
    float last_y = 0.0f, last_across = 0.0f;
    bool had_width = false;
    for (int i = 0; i < n;) {
        const int first = i;
        const float y = track->places[first].y;
        bool has_width = widen(track, n, &i, &across);
        float stretch = first > 0 ? -above * (y - last_y) : 0.0f; /* above + below is 0 */
        sum += stretch * (across + last_across);
        total += stretch * ((has_width ? 1.0f : 0.0f) + (had_width ? 1.0f : 0.0f));
        for (int k = first; k < i; k++) {
            above += track->weights[k] * (y - middle.y);
            moment += track->weights[k] * square(y - middle.y);
            down += track->weights[k] * (y - middle.y) * track->moves[k].y;
        }
        last_y = y;
        last_across = across;
        had_width = has_width;
    }
    if (total > 0.0f) {
        *upright = 2.0f * sum / total - down / moment;
    }
    return total > 0.0f;
}

/* The growth of a window; false if too few of its points are found. */
static bool grow(dlgmd_track *track, image (*pair)[N_LEVELS], dlgmd_window window, growth *found)
{
    int n_found = follow_all(track, pair, window);
    if (n_found < MIN_POINTS) {
        return false;
    }
    *found = fit(track, n_found);
    return stand(track, n_found, &found->upright);
}

/* The middle of a part of a side of n cells, from -1 to 1. */
static float place_in(float first, float last, int n)
{
    return (first + last + 1.0f) * (1.0f / (float)n) - 1.0f;
}

/* A step within the limits, in seconds. */
static float seconds_of(uint32_t step_us)
{
    return step_us > 0 ? 1e-6f * limited((float)step_us, MIN_STEP_US, MAX_STEP_US) : USUAL_S;
}

/* How many frames ago the image was that is compared, the latest that is old enough, or the oldest
   that is kept; `age_s` is the time since the frame before, and becomes that since this one. */
static uint32_t n_ago_of(const dlgmd_state *state, float *age_s)
{
    uint32_t n_ago = 1;
    while (*age_s < LEAST_S && n_ago < EARLIER && n_ago < state->frame) {
        *age_s += seconds_of(state->steps_us[(state->frame - n_ago) % EARLIER]);
        n_ago++;
    }
    return n_ago;
}

/* Add the rates ahead to their means. */
static void measure(dlgmd_state *state, const uint8_t *frame, uint32_t step_us)
{
    float step_s = seconds_of(step_us), age_s = step_s;
    uint32_t n_ago = n_ago_of(state, &age_s);
    image pair[2][N_LEVELS];
    growth ahead;
    pair[0][0] = image_of(state, frame, n_ago);
    pair[1][0] = image_of(state, frame, 0);
    for (int i = 0; i < 2; i++) {
        see_levels(&state->work.track, pair[i], state->work.track.pyramids[i]);
    }
    float newest = share_of_newest(step_s, AHEAD_RATE), weight = 0.0f, sum = 0.0f, upright = 0.0f;
    if (grow(&state->work.track, pair, state->window, &ahead)) {
        weight = newest * square(ERROR) / (square(ERROR) + ahead.variance / square(age_s));
        sum = weight * ahead.rate / age_s;
        upright = weight * ahead.upright / age_s;
    }
    state->age = (1.0f - newest) * (state->age + step_s * state->weight);
    state->weight += weight - newest * state->weight;
    state->sum += sum - newest * state->sum;
    state->upright += upright - newest * state->upright;
}

/* Measure how fast the image expands, and tell it. */
static void expand(dlgmd_state *state, const uint8_t *frame, uint32_t step_us, dlgmd_answer *answer)
{
    measure(state, frame, step_us);
    const dlgmd_window *window = &state->window;
    float quality = state->weight;
    if (quality > LEAST_WEIGHT) {
        answer->expansion = state->sum / quality;
        answer->expansion_upright = state->upright / quality;
    }
    answer->expansion_quality = quality;
    answer->expansion_x = place_in(window->left, window->right, WIDTH);
    answer->expansion_y = place_in(window->top, window->bottom, HEIGHT);
    answer->has_ttc = quality >= LEAST_QUALITY && answer->expansion >= LEAST_RATE;
    if (answer->has_ttc) {
        float ttc_s = 1.0f / answer->expansion - state->age / quality;
        answer->ttc_s = ttc_s > 0.0f ? ttc_s : 0.0f;
    }
    /* What stands ahead, without level ground. */
    float ahead = answer->expansion_upright;
    ahead = ahead < answer->expansion ? ahead : answer->expansion;
    ahead *= quality < LEAST_QUALITY ? quality / LEAST_QUALITY : 1.0f;
    answer->alarm = DLGMD_RULE == DLGMD_TTC
                        ? answer->ttc_s <= TTC_ALARM
                        : ahead >= EXPANSION_ALARM;
}

#if DLGMD_RULE != DLGMD_SPIKES
/* Whether the quality has been too low for too long; its first low frame counts as 1 ms. */
static bool is_unmeasured(dlgmd_state *state, uint32_t step_us)
{
    if (state->weight >= LEAST_MEASURED) {
        state->low_s = 0.0f;
    } else if (state->low_s < BLIND_S) {
        state->low_s += state->low_s > 0.0f ? seconds_of(step_us) : 1e-3f;
    }
    return state->low_s >= BLIND_S;
}
#endif

/* 1 - square / (n (n + 1)) (1 - square / ((n + 2) (n + 3)) (1 - ...)). */
static float series(float angle, int n)
{
    float sum = 1.0f;
    for (int k = n + 16; k > n; k -= 2) {
        sum = 1.0f - square(angle) * sum / (float)((k - 2) * (k - 1));
    }
    return sum;
}

/* The place along a side of n cells of a direction, in 1/100 degree from the axis. */
static float place_at(int32_t cdeg, int n)
{
    float angle = limited((float)cdeg, -8900.0f, 8900.0f) * 1.74532925e-4f;
    return (float)(n - 1) / 2.0f + FOCAL * angle * series(angle, 2) / series(angle, 1);
}

/* The length of a part of a side of n cells that is inside. */
static float inside(float first, float last, int n)
{
    first = limited(first, 0.0f, (float)n - 1.0f);
    return limited(last, first, (float)n - 1.0f) - first;
}

void dlgmd_heading(dlgmd_state *state, int32_t right_cdeg, int32_t up_cdeg)
{
    state->window = usual_window;
    if (right_cdeg < -9000 || right_cdeg > 9000 || up_cdeg < -9000 || up_cdeg > 9000) {
        return;
    }
    dlgmd_window at = {
        place_at(-up_cdeg - ABOVE_CDEG, HEIGHT), place_at(-up_cdeg + BELOW_CDEG, HEIGHT),
        place_at(right_cdeg - BESIDE_CDEG, WIDTH), place_at(right_cdeg + BESIDE_CDEG, WIDTH)};
    float shown = inside(at.left, at.right, WIDTH) * inside(at.top, at.bottom, HEIGHT);
    float whole = (at.right - at.left) * (at.bottom - at.top);
    if (shown > 0.0f && shown >= LEAST_SHOWN * whole) {
        state->window = at;
    }
}

#endif

dlgmd_answer dlgmd_step_us(dlgmd_state *state, const uint8_t *frame, uint32_t step_us)
{
    dlgmd_answer answer = {0};
    answer.ttc_s = DLGMD_NO_TTC;
    totals sums = {0};
    if (state->frame == 0) {
        memcpy(frame_before(state, 1), frame, CELLS);
    }
#if DLGMD_EVENS
    see_light(state, frame);
#endif
#if DLGMD_EXPANSION
    if (state->frame > 0) {
        expand(state, frame, step_us, &answer);
    }
    state->steps_us[state->frame % EARLIER] = step_us;
#else
    (void)step_us;
#endif
    answer.valid = respond(state, frame, &sums);
    state->frame++;
    state->start = (state->start + DLGMD_PERIOD) % ROWS;
    if (answer.valid) {
        finish(&answer, &sums);
        answer.spike = answer.mp_abs >= T_MP;
    }
    answer.rule = DLGMD_RULE;
#if DLGMD_RULE == DLGMD_SPIKES
    state->spikes = answer.spike ? state->spikes + 1 : 0;
    answer.alarm = state->spikes >= N_SP;
#else
    answer.unmeasured = is_unmeasured(state, step_us) && !answer.alarm;
#endif
    return answer;
}

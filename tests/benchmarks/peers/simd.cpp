// The drill with smoothed friction, classical Runge-Kutta steps, W lanes abreast in the vector registers.
//
// sgn u is u/width within the width and sharp beyond it: 3 to 4 times more exact for the same width than u/sqrt(u^2 +
// width^2), and cheaper.
//
// Every lane has its own clock and its own length of step, from its state alone: short where friction is steep (|u| small)
// and in contact, and such that steps end near the beginning and the end of a contact, where the force has a kink. Nothing
// is iterated, so that lanes never wait for one another but at the end of the block.
#include <cmath>
#include <limits>

namespace {

constexpr double M1 = 250, K1 = 156250, C2 = 250, MU = .4, FST = .4 * 250 * 9.81, VCR = 3, K0 = 50e6, C0 = .1;
constexpr double SHORT_OF = .9;  // of the way to the steep part of friction: no stage of the step reaches into it
constexpr double SHORTEST = 1e-9;    // s
constexpr double ARMED_BELOW = .05;  // of v: how far x1' must have fallen before its next rise through zero is a return

struct Setting {
    double width;    // m/s, of the friction switch
    double steep;    // length of a step where friction is steep, in units of its time scale there
    double flight;   // s, the longest step
    double contact;  // s, the longest step in contact
};

struct Returns {
    double first = 0, last = 0, total = 0, pending_total = 0;
    int number = 0, impacts = 0, pending = 0;
};

template <int W> struct Block {
    alignas(64) double im2[W], k2[W], v[W], gap[W], x1[W], v1[W], x2[W], v2[W], t[W];
    alignas(64) double old_v1[W], old_x2[W], old_a1[W], h[W], slowest[W], event[W];
};

// x1'' and x2''; press is J
inline __attribute__((always_inline)) void rates(double a, double va, double c, double vc, double k2, double im2, double v,
                                                 double gap, double width, double& aa, double& ac, double& press) {
    const double u = va + v, turn = std::fmin(std::fmax(u / width, -1.), 1.), r = std::fabs(u) * (1 / VCR), d = c - gap;
    double J = K0 * d + C0 * vc;
    J = (d >= 0 && J > 0) ? J : 0.;
    const double pull = k2 * (a - c);
    aa = (-K1 * a - pull - turn * (FST * (1 - r + r * r * r * (1. / 3)) + MU * J)) * (1 / M1);
    ac = (-C2 * vc + pull - J) * im2;
    press = J;
}

// The time in a step at which x1' rises through zero, on the cubic through its ends.
double crossing(double y0, double y1, double d0, double d1, double h) {
    const double change = y1 - y0, c1 = h * d0, c2 = 3 * change - 2 * c1 - h * d1, c3 = c1 + h * d1 - 2 * change;
    double s = -y0 / change;
    for (int i = 0; i < 6; i++) s -= (y0 + s * (c1 + s * (c2 + s * c3))) / (c1 + s * (2 * c2 + s * 3 * c3));
    return std::fmin(std::fmax(s, 0.), 1.) * h;
}

template <int W> long run_block(const double* beta, const double* gamma, const double* speed, const double* delta,
                                double settle, double observe, Setting set, double* period, double* velocity) {
    Block<W> q;
    Returns found[W];
    const double end = settle + observe;
    for (int i = 0; i < W; i++) {
        q.im2[i] = 1 / (beta[i] * M1), q.k2[i] = beta[i] * gamma[i] * gamma[i] * K1, q.v[i] = speed[i], q.gap[i] = delta[i];
        q.x1[i] = q.x2[i] = q.v2[i] = q.t[i] = 0, q.v1[i] = q.slowest[i] = -speed[i];
    }
    long steps = 0;
    for (double behind = 0; behind < end; steps++) {
        double any = 0;
        behind = end;
#pragma omp simd reduction(+ : any) reduction(min : behind)
        for (int i = 0; i < W; i++) {
            const double k2 = q.k2[i], im2 = q.im2[i], v = q.v[i], gap = q.gap[i], width = set.width;
            const double a = q.x1[i], p = q.v1[i], c = q.x2[i], s = q.v2[i], t = q.t[i];
            double a1, c1, a2, c2, a3, c3, a4, c4, press, unused;
            rates(a, p, c, s, k2, im2, v, gap, width, a1, c1, press);
            // The length of the step
            const double d = c - gap, away = std::fabs(d), towards = d < 0 ? s : -s, slows = d < 0 ? c1 : -c1;
            double h = std::fmin(set.flight, end - t);
            const double u = p + v, size = std::fabs(u), stops = u < 0 ? a1 : -a1;
            const double steep = set.steep * width * M1 / (FST + MU * press);
            const double pulls = (k2 * (s - p) - K1 * p) * (1 / M1), brakes = u < 0 ? pulls : -pulls;
            const double left = SHORT_OF * (size - width);
            double stop = std::fmin(left / std::fmax(stops, 1e-300), h);
            stop = left / std::fmax(stops + .5 * brakes * stop, 1e-300);
            stop = left / std::fmax(stops + .5 * brakes * std::fmin(stop, h), 1e-300);
            stop = size > 1.2 * width ? stop : 0;
            h = std::fmin(h, std::fmax(steep, stop));
            h = d >= 0 ? std::fmin(h, set.contact) : h;
            double hit = away / (std::fabs(towards) + 1e-300);
            hit = away / std::fmax(towards + .5 * slows * std::fmin(hit, h), 1e-300);
            hit = away / std::fmax(towards + .5 * slows * std::fmin(hit, h), 1e-300);
            hit = std::fmax(hit, SHORTEST);
            h = towards > 0 ? std::fmin(h, hit) : h;
            // The step
            const double g = h * .5, w = h * (1. / 6);
            const double p2 = p + g * a1, s2 = s + g * c1;
            rates(a + g * p, p2, c + g * s, s2, k2, im2, v, gap, width, a2, c2, unused);
            const double p3 = p + g * a2, s3 = s + g * c2;
            rates(a + g * p2, p3, c + g * s2, s3, k2, im2, v, gap, width, a3, c3, unused);
            const double p4 = p + h * a3, s4 = s + h * c3;
            rates(a + h * p3, p4, c + h * s3, s4, k2, im2, v, gap, width, a4, c4, unused);
            const double new_v1 = p + w * (a1 + 2 * a2 + 2 * a3 + a4), new_x2 = c + w * (s + 2 * s2 + 2 * s3 + s4);
            q.x1[i] = a + w * (p + 2 * p2 + 2 * p3 + p4), q.v1[i] = new_v1;
            q.x2[i] = new_x2, q.v2[i] = s + w * (c1 + 2 * c2 + 2 * c3 + c4);
            q.t[i] = t + h, q.h[i] = h, q.old_v1[i] = p, q.old_x2[i] = c, q.old_a1[i] = a1;
            q.slowest[i] = std::fmin(q.slowest[i], p);
            q.event[i] = (p <= 0 && new_v1 > 0) || (c < gap && new_x2 >= gap) ? 1. : 0.;
            any += q.event[i];
            behind = std::fmin(behind, q.t[i]);
        }
        if (any == 0) continue;
        for (int i = 0; i < W; i++) {
            if (q.event[i] == 0) continue;
            Returns& r = found[i];
            double aa, ac, press;
            rates(q.x1[i], q.v1[i], q.x2[i], q.v2[i], q.k2[i], q.im2[i], q.v[i], q.gap[i], set.width, aa, ac, press);
            if (q.old_x2[i] < q.gap[i] && q.x2[i] >= q.gap[i] && r.number > 0)
                r.pending++, r.pending_total += q.v2[i] - ac * (q.x2[i] - q.gap[i]) / q.v2[i];
            if (q.old_v1[i] > 0 || q.v1[i] <= 0) continue;
            const double at = q.t[i] - q.h[i] + crossing(q.old_v1[i], q.v1[i], q.old_a1[i], aa, q.h[i]);
            const bool armed = q.slowest[i] < -ARMED_BELOW * q.v[i];
            if (armed) q.slowest[i] = 0;
            if (!armed || at < settle) continue;
            r.number++ == 0 ? (r.first = at) : (r.impacts += r.pending, r.total += r.pending_total);
            r.last = at, r.pending = 0, r.pending_total = 0;
        }
    }
    for (int i = 0; i < W; i++) {
        const Returns& r = found[i];
        period[i] = r.number > 1 ? (r.last - r.first) / (r.number - 1) : std::numeric_limits<double>::infinity();
        velocity[i] = r.impacts ? r.total / r.impacts : std::numeric_limits<double>::infinity();
    }
    return steps;
}

}  // namespace

// Lanes in blocks of `LANES`, a multiple of which there must be; returns the steps of all blocks together.
extern "C" long simd_run(int lanes, const double* beta, const double* gamma, const double* v, const double* delta, double settle,
                         double observe, const double* setting, int threads, double* period, double* velocity) {
    const Setting set{setting[0], setting[1], setting[2], setting[3]};
    long steps = 0;
#pragma omp parallel for schedule(dynamic) num_threads(threads) reduction(+ : steps)
    for (int b = 0; b < lanes; b += LANES)
        steps += run_block<LANES>(beta + b, gamma + b, v + b, delta + b, settle, observe, set, period + b, velocity + b);
    return steps;
}

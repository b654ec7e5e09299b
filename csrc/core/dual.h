// Numbers that carry their derivatives: a formula written once gives its value and its gradient.
#pragma once

#include <array>
#include <cmath>

namespace nmbg {

// A value and its derivatives with respect to N variables.
template <class T, int N>
struct Dual {
    T value;
    std::array<T, N> slope{};

    Dual(T v = 0) : value(v) {}

    static Dual variable(T v, int i) {
        Dual x(v);
        x.slope[i] = 1;
        return x;
    }

    // The same slopes scaled by the derivative of an outer function, whose value is `v`.
    Dual chained(T v, T derivative) const {
        Dual y(v);
        for (int i = 0; i < N; ++i) y.slope[i] = derivative * slope[i];
        return y;
    }

    friend Dual operator-(const Dual& a) { return a.chained(-a.value, -1); }
    friend Dual operator+(const Dual& a, const Dual& b) {
        Dual y(a.value + b.value);
        for (int i = 0; i < N; ++i) y.slope[i] = a.slope[i] + b.slope[i];
        return y;
    }
    friend Dual operator-(const Dual& a, const Dual& b) { return a + -b; }
    friend Dual operator*(const Dual& a, const Dual& b) {
        Dual y(a.value * b.value);
        for (int i = 0; i < N; ++i) y.slope[i] = a.slope[i] * b.value + a.value * b.slope[i];
        return y;
    }
    friend Dual operator/(const Dual& a, const Dual& b) {
        Dual y(a.value / b.value);
        for (int i = 0; i < N; ++i) y.slope[i] = (a.slope[i] - y.value * b.slope[i]) / b.value;
        return y;
    }
    Dual& operator+=(const Dual& b) { return *this = *this + b; }
    friend bool operator<(const Dual& a, const Dual& b) { return a.value < b.value; }
    friend bool operator>(const Dual& a, const Dual& b) { return b < a; }

    friend Dual sqrt(const Dual& a) {
        const T root = std::sqrt(a.value);
        return a.chained(root, T(0.5) / root);
    }
    friend Dual abs(const Dual& a) { return a.value < 0 ? -a : a; }
    friend Dual log2(const Dual& a) { return a.chained(std::log2(a.value), T(1.4426950408889634) / a.value); }
};

template <class T, int N>
T value_of(const Dual<T, N>& x) {
    return x.value;
}

}  // namespace nmbg

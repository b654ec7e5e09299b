// A step of Adam for some rows of a table (Kingma and Ba, "Adam: A method for stochastic optimization",
// 2015).
#pragma once

#include <cstdint>

namespace nmbg {

// The problem. T is float or double.
template <class T>
struct AdamRows {
    T *table, *mean, *square;  // [all rows, width]; mean and square are Adam's moments
    const int64_t* index;      // [rows] which rows, each at most once
    const T* grad;             // [rows, width] their gradients
    int64_t all, rows;
    int64_t width;
    double beta1, beta2, eps;
    double rate;  // of learning, the corrections of both moments included
    int threads;
};

// mean ← β₁ mean + (1 - β₁) g, square ← β₂ square + (1 - β₂) g², table ← table - rate mean / (√square + ε).
// Throws std::invalid_argument, before anything is written, where an index leads outside of the table.
template <class T>
void adam_rows(const AdamRows<T>& adam);

}  // namespace nmbg

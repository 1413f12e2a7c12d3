// Stands in for STruC++'s runtime headers where STruC++ is not installed: its conventions as far as generated blocks
// use them. A variable is an object that may be forced; names are in capitals; an array of strings holds 254 characters
// of each, whatever is declared.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>

namespace strucpp {

template <class T> class IECVar {
    T value_{}, forced_value_{};
    bool forced_ = false;

public:
    IECVar() = default;
    IECVar(T v) : value_(v) {}
    IECVar(const IECVar &other) : value_(other.get()) {}
    IECVar &operator=(const IECVar &other) { return *this = other.get(); }
    IECVar &operator=(T v)
    {
        if (!forced_)
            value_ = v;
        return *this;
    }
    T get() const { return forced_ ? forced_value_ : value_; }
    operator T() const { return get(); }
};

template <size_t Most = 254> class IECString {
    char data_[Most + 1] = "";
    size_t length_ = 0;

public:
    IECString() = default;
    IECString(const char *text) : IECString(text, std::strlen(text)) {}
    IECString(const char *text, size_t length) : length_(length < Most ? length : Most)
    {
        std::memcpy(data_, text, length_);
        data_[length_] = 0;
    }
    size_t length() const { return length_; }
    const char *c_str() const { return data_; }
};

template <size_t Most = 254> class IECStringVar {
    IECString<Most> value_;

public:
    IECStringVar() = default;
    IECStringVar(const char *text) : value_(text) {}
    IECString<Most> get() const { return value_; }
    void set(const IECString<Most> &text) { value_ = text; }
};

template <class T, int64_t Low, int64_t High> class Array1D {
    std::array<T, static_cast<size_t>(High - Low + 1)> data_{};

public:
    T &operator[](int64_t index) { return data_[static_cast<size_t>(index - Low)]; }
    const T &operator[](int64_t index) const { return data_[static_cast<size_t>(index - Low)]; }
};

using IEC_BOOL = IECVar<bool>;
using IEC_BYTE = IECVar<uint8_t>;
using IEC_SINT = IECVar<int8_t>;
using IEC_USINT = IECVar<uint8_t>;
using IEC_INT = IECVar<int16_t>;
using IEC_UINT = IECVar<uint16_t>;
using IEC_DINT = IECVar<int32_t>;
using IEC_UDINT = IECVar<uint32_t>;
using IEC_LINT = IECVar<int64_t>;
using IEC_ULINT = IECVar<uint64_t>;
using IEC_REAL = IECVar<float>;
using IEC_LREAL = IECVar<double>;
using IEC_TIME = IECVar<int64_t>;

} // namespace strucpp

// SPDX-License-Identifier: BSD-3-Clause
#include <pybind11/pybind11.h>

#include <atomic>
#include <cctype>
#include <cerrno>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <string_view>

#include "ndtree/core/memory.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/io/byte_stream.hpp"
#include "python_map.hpp"

namespace ndtree::python {

namespace {

std::atomic<unsigned long> main_thread{0};

/// Numbers with more digits than any double has are said in the few that it has: 1e+300, not 301 digits.
std::string with_short_numbers(std::string_view text) {
  constexpr std::size_t kMostDigits = 20;
  const auto is_digit = [&](std::size_t i) {
    return i < text.size() && std::isdigit(static_cast<unsigned char>(text[i])) != 0;
  };
  std::string out;
  for (std::size_t i = 0; i < text.size();) {
    std::size_t end = i;
    while (is_digit(end)) ++end;
    if (end - i <= kMostDigits) {
      end = std::max(end, i + 1);
      out.append(text.substr(i, end - i));
    } else {
      if (end < text.size() && text[end] == '.' && is_digit(end + 1))
        for (++end; is_digit(end);) ++end;
      out += shortest_text(std::strtod(std::string(text.substr(i, end - i)).c_str(), nullptr));
    }
    i = end;
  }
  return out;
}

/// Text of foreign files may be in no encoding.
void set_error(PyObject* type, const char* what) {
  const std::string text = with_short_numbers(what);
  PyObject* const message =
      PyUnicode_DecodeUTF8(text.data(), static_cast<Py_ssize_t>(text.size()), "backslashreplace");
  if (message == nullptr) return;  // Another error is set.
  PyErr_SetObject(type, message);
  Py_DECREF(message);
}

/// The system's error number makes it FileNotFoundError, PermissionError, ...
void set_os_error(const std::filesystem::filesystem_error& error) {
  namespace py = pybind11;
  const auto* const refused = dynamic_cast<const FileError*>(&error);
  const int number = error.code().value();
  const auto path = py::reinterpret_steal<py::object>(PyUnicode_DecodeFSDefault(error.path1().c_str()));
  const py::str reason(refused != nullptr ? refused->reason() : error.code().message());
  const py::object made = py::reinterpret_borrow<py::object>(PyExc_OSError)(py::int_(number), reason, path);
  PyErr_SetObject(py::type::of(made).ptr(), made.ptr());
}

void translate(std::exception_ptr pointer) {
  namespace py = pybind11;
  try {
    if (pointer) std::rethrow_exception(pointer);
  } catch (const Cancelled&) {  // By what a signal's handler has raised.
    if (PyErr_Occurred() == nullptr) PyErr_SetNone(PyExc_KeyboardInterrupt);
  } catch (const MemoryLimitReached& error) {
    set_error(PyExc_MemoryError, error.what());
  } catch (const std::filesystem::filesystem_error& error) {
    set_os_error(error);
  } catch (const py::value_error& error) {
    set_error(PyExc_ValueError, error.what());
  } catch (const py::type_error& error) {
    set_error(PyExc_TypeError, error.what());
  } catch (const py::cast_error& error) {  // What pybind11 adds for its own developers is left out.
    const std::string_view text = error.what();
    set_error(PyExc_TypeError, std::string(text.substr(0, text.find(" (#define"))).c_str());
  } catch (const py::builtin_exception&) {
    throw;
  } catch (const py::error_already_set&) {
    throw;
  } catch (const OptionError& error) {
    const py::object made =
        py::module_::import("ndtree._errors")
            .attr("WrongValue")
            .attr("of_library")(error.field(), py::str(with_short_numbers(error.value())),
                                with_short_numbers(error.expected()), error.other(), error.value_of_other());
    PyErr_SetObject(py::type::of(made).ptr(), made.ptr());
  } catch (const std::invalid_argument& error) {
    set_error(PyExc_ValueError, error.what());
  } catch (const std::domain_error& error) {
    set_error(PyExc_ValueError, error.what());
  } catch (const std::length_error&) {  // A container that cannot be so long.
    set_error(PyExc_MemoryError, "not enough memory");
  } catch (const std::bad_alloc&) {
    set_error(PyExc_MemoryError, "not enough memory");
  } catch (const std::runtime_error& error) {
    set_error(PyExc_RuntimeError, error.what());
  }
}

}  // namespace

bool Released::hears_signals() {
  return PyThread_get_thread_ident() == main_thread.load(std::memory_order_relaxed);
}

void bind_errors(pybind11::module_&) {
  main_thread =
      pybind11::module_::import("threading").attr("main_thread")().attr("ident").cast<unsigned long>();
  pybind11::register_exception_translator(translate);
  namespace py = pybind11;
  const py::module_ os = py::module_::import("os");
  if (!py::hasattr(os, "register_at_fork")) return;
  os.attr("register_at_fork")(
      py::arg("before") = py::cpp_function(&CallInProgress::before_fork),
      py::arg("after_in_parent") = py::cpp_function(&CallInProgress::after_fork_in_parent),
      py::arg("after_in_child") = py::cpp_function([] {
        CallInProgress::after_fork_in_child();
        main_thread = PyThread_get_thread_ident();
      }));
}

}  // namespace ndtree::python

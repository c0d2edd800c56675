"""Is there a Vulkan device? A program that prints what is missing, or nothing; it imports nothing of this project."""

from __future__ import annotations

import ctypes


class InstanceInfo(ctypes.Structure):
    """VkInstanceCreateInfo."""

    _fields_ = (
        ("sType", ctypes.c_int),
        ("pNext", ctypes.c_void_p),
        ("flags", ctypes.c_uint32),
        ("pApplicationInfo", ctypes.c_void_p),
        ("layers", ctypes.c_uint32),
        ("ppLayers", ctypes.c_void_p),
        ("extensions", ctypes.c_uint32),
        ("ppExtensions", ctypes.c_void_p),
    )


def what_is_missing() -> str:
    """What Vulkan lacks here; empty if it has a device."""
    try:
        vulkan = ctypes.CDLL("libvulkan.so.1")
    except OSError as error:
        return f"no Vulkan library ({error})"
    instance, count = ctypes.c_void_p(), ctypes.c_uint32()
    info = InstanceInfo(sType=1)  # VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO
    if code := vulkan.vkCreateInstance(ctypes.byref(info), None, ctypes.byref(instance)):
        return f"no Vulkan driver (vkCreateInstance gave {code})"
    vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
    vulkan.vkDestroyInstance(instance, None)
    return "" if count.value else "no Vulkan device"


if __name__ == "__main__":
    print(what_is_missing())

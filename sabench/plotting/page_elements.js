"use strict";
// What the pages of sabench share: their scripts begin with it.
const SVG = "http://www.w3.org/2000/svg";

// An element with attributes (null, false and undefined are left out; functions listen to the event of that name) and children.
function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name, value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== null && value !== false && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children.flat(2).filter(child => child !== null && child !== undefined && child !== false));
  return element;
}

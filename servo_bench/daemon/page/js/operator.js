// Who stands at this browser. Kept in it, so that it is asked once.

const KEY = "servo-bench operator";
let said = "";

export const operator = {
  get name() {
    try {
      return localStorage.getItem(KEY) ?? said;
    } catch {
      return said; // a browser that keeps nothing: known until the page is left
    }
  },
  set name(name) {
    said = name;
    try {
      localStorage.setItem(KEY, name);
    } catch (error) {
      console.info("the operator's name is not kept:", error.name);
    }
  },
};
